"""A simulation written down as a case."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.case.document import plain
from qbxstokes.case.scene import FREE
from qbxstokes.errors import SceneError
from qbxstokes.flows import Flow
from qbxstokes.geometry.shape import Shape
from qbxstokes.geometry.spheroid import Spheroid

if TYPE_CHECKING:
    from qbxstokes.simulation.simulation import Simulation


_BOUND = {"translation": "velocity", "rotation": "angular_velocity"}


def to_case(scene: Simulation, times: ArrayLike | None = None) -> dict[str, Any]:
    """The keys of a case that writes the simulation down; lanes become an axis of a sweep.

    times: instants to store, increasing. Raises SceneError naming what cannot be written, such as
    a Python function.
    """
    case: dict[str, Any] = {"task": "motion"}
    case |= _coupled(scene) if scene.coupled else _alone(scene)
    if scene.flow is not None:
        case["flow"] = _flow_keys(scene.flow)
    case["time"] = {"tolerance": scene.tolerance}
    if times is not None:
        case["time"]["at"] = np.asarray(times, dtype=float)
    return case


def _alone(scene: Simulation) -> dict[str, Any]:
    """Sections of a body alone, or of the lanes of one."""
    body = scene.body
    member = _member(scene, 0)
    case: dict[str, Any] = {
        "body": _shape_keys(body.shape),
        "hydrodynamics": _given(plain(body.settings)),
        "events": _given(plain(scene.events)),
    }
    if body.inertia != "both":
        case["body"]["inertia"] = body.inertia
    if scene.brownian is not None:
        case["brownian"] = _given(plain(scene.brownian))
    if "forces" in member:
        case["forces"] = member["forces"]
    if scene.constraints is not None:
        case["constraints"] = {
            name: FREE if value is None else _vector(f"constraints.{other}", value)
            for name, other in _BOUND.items()
            for value in [getattr(scene.constraints, other)]
        }
    if not scene.lanes:
        case["body"]["stokes_number"] = member["stokes_number"]
        return case | {"start": member["start"]}
    rows = {
        "body.stokes_number": scene.stokes_number,
        "start.position": scene.position,
        "start.orientation": scene.quaternion,
        "start.velocity": scene.velocity,
        "start.angular_velocity": scene.angular_velocity,
    }
    return case | {
        "sweep": {"axes": [{name: row for name, row in rows.items() if row is not None}]}
    }


def _coupled(scene: Any) -> dict[str, Any]:
    """Sections of bodies that share a fluid, or of one by a wall."""
    bodies = scene.suspension.bodies
    members = [
        _shape_keys(body.shape) | {"size": body.size} | _member(scene, index)
        for index, body in enumerate(bodies)
    ]
    case: dict[str, Any] = {"hydrodynamics": {"tolerance": scene.suspension.tolerance}}
    if scene.several:
        case["bodies"] = members
    else:
        (one,) = members
        case |= {name: one.pop(name) for name in ("start", "forces") if name in one}
        if one.pop("size") != 1.0:
            raise SceneError("bodies", "is one with a size", "a list of one body")
        case["body"] = one
    if scene.suspension.wall is not None:
        case["surroundings"] = {"type": "wall", **vars(scene.suspension.wall)}
    if scene.repulsion is not None:
        case["repulsion"] = vars(scene.repulsion)
    if scene.table is not None:
        case["hydrodynamics"]["solve"] = "functional"
    watched = {name: getattr(scene.events, name) for name in ("clearance", "turning_points")}
    return case | _given({"events": _given(watched)})


def _member(scene: Simulation, index: int) -> dict[str, Any]:
    """Stokes number, start and forces of one of the bodies, or of a lane."""
    shape, start = (len(scene), 3), {"orientation": {"quaternion": scene.quaternion[index]}}
    for name in ("position", "velocity", "angular_velocity"):
        if getattr(scene, name) is not None:
            start[name] = np.broadcast_to(getattr(scene, name), shape)[index]
    found = {"stokes_number": float(scene.stokes_number[index]), "start": start}
    forces: dict[str, Any] = {} if scene.loads is None else dict(vars(scene.loads))
    for name, value in forces.items():
        if scene.coupled and not callable(value):
            forces[name] = np.broadcast_to(value, shape)[index]
    forces = {
        name: _vector(f"loads.{name}", value)
        for name, value in forces.items()
        if callable(value) or np.any(value)
    }
    return found | _given({"forces": forces})


def _given(keys: Mapping[str, Any]) -> dict[str, Any]:
    """Those of the keys that say something."""
    return {name: value for name, value in keys.items() if value not in (None, [], (), {})}


def _shape_keys(shape: Shape) -> dict[str, Any]:
    short = isinstance(shape, Spheroid)
    return {**shape.parameters} if short else {"shape": shape.spec()}


def _flow_keys(flow: Flow) -> Any:
    keys = plain(flow.spec())
    if not all(entry is None or isinstance(entry, str | int | float) for entry in _entries(keys)):
        right = "a function in a file, FILE.py:NAME, or a file of a series"
        raise SceneError("flow", "holds a Python function, which no file holds", right)
    return keys


def _entries(keys: Any) -> Iterator[Any]:
    """What stands in a specification, at any depth."""
    if isinstance(keys, list | dict):
        for entry in keys.values() if isinstance(keys, dict) else keys:
            yield from _entries(entry)
    else:
        yield keys


def _vector(name: str, value: Any) -> list[float]:
    if callable(value):
        right = "numbers, expressions in t, a table, or FILE.py:NAME in a case"
        raise SceneError(name, "is a Python function, which no file holds", right)
    if np.ndim(value) > 1:
        raise SceneError(name, "differs from lane to lane", "the same for all lanes")
    return [float(part) for part in np.asarray(value)]
