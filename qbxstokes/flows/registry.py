"""Flows by name: a new flow is one new file and one line in `REGISTRY`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from qbxstokes.errors import FlowError, nearest
from qbxstokes.flows.base import Flow, SumFlow, TransformedFlow
from qbxstokes.flows.changing import ChangingFlow, in_time
from qbxstokes.flows.named import (
    Extension,
    Linear,
    Paraboloid,
    PlanePoiseuille,
    Rotation,
    Shear,
    TubePoiseuille,
    Uniform,
    WallStagnation,
)
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.flows.singularities import AboveWall, Rotlet, Stokeslet, Stresslet
from qbxstokes.flows.user import UserFlow, resolve_paths
from qbxstokes.flows.values import rotation_matrix, tensor

REGISTRY: dict[str, type[Flow]] = {
    "uniform": Uniform,
    "linear": Linear,
    "shear": Shear,
    "extension": Extension,
    "rotation": Rotation,
    "paraboloid": Paraboloid,
    "plane_poiseuille": PlanePoiseuille,
    "tube_poiseuille": TubePoiseuille,
    "wall_stagnation": WallStagnation,
    "polynomial": PolynomialFlow,
    "stokeslet": Stokeslet,
    "rotlet": Rotlet,
    "stresslet": Stresslet,
    "above_wall": AboveWall,
    "sum": SumFlow,
    "transformed": TransformedFlow,
    "user": UserFlow,
}


def build_flow(spec: Mapping[str, Any], directory: str | Path | None = None) -> Flow:
    """Flow from {"type": name, ..., "position": [3], "rotation": ...}.

    `rotation` (quaternion, {axis, angle} or matrix) turns the whole flow about its own origin,
    then `position` moves that origin. Files of user functions are relative to `directory`.
    Raises FlowError that says what would be right.
    """
    if not isinstance(spec, Mapping):
        raise FlowError(f"flow must be a mapping with a key 'type', not {spec!r}")
    rest = dict(spec) if directory is None else resolve_paths(spec, directory)
    name = rest.pop("type", None)
    if name not in REGISTRY:
        hint = nearest(str(name), REGISTRY, f"known flows: {', '.join(REGISTRY)}")
        what = "flow needs a key 'type'" if name is None else f"unknown flow type {name!r}"
        raise FlowError(f"{what}; {hint}", () if name is None else ("type",))
    position = rest.pop("position", None)
    rotation = rest.pop("rotation", None)
    kind = REGISTRY[name]
    flow = in_time(kind, rest, build_flow) or kind.from_spec(rest, build_flow)
    if position is None and rotation is None:
        return flow
    if rotation is not None:
        flow = flow.rotated(rotation_matrix(rotation))
    if position is not None:
        flow = flow.shifted(tensor(position, "position", (3,)))
    # Tensors moved and turned would hide what was asked for; keep its name for the record.
    return flow.named(dict(spec)) if isinstance(flow, (PolynomialFlow, ChangingFlow)) else flow
