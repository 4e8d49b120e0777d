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
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.coupled import CoupledSimulation
    from qbxstokes.simulation.simulation import Simulation


_BOUND = {"translation": "velocity", "rotation": "angular_velocity"}


def to_case(scene: Simulation, times: ArrayLike | None = None) -> dict[str, Any]:
    """The keys of a case that writes the simulation down; lanes become an axis of a sweep.

    times: instants to store, increasing. Raises SceneError naming what cannot be written, such as
    a Python function.
    """
    body = scene.body
    hydrodynamics = plain(body.settings)
    case: dict[str, Any] = {
        "task": "motion",
        "body": _shape_keys(body.shape),
        "flow": _flow_keys(scene.flow),
        "hydrodynamics": {name: v for name, v in hydrodynamics.items() if v is not None},
        "events": {n: v for n, v in plain(scene.events).items() if v not in (None, [], ())},
        "time": {"tolerance": scene.tolerance},
    }
    if times is not None:
        case["time"]["at"] = np.asarray(times, dtype=float).tolist()
    if body.inertia != "both":
        case["body"]["inertia"] = body.inertia
    if scene.brownian is not None:
        case["brownian"] = {n: v for n, v in plain(scene.brownian).items() if v is not None}
    if scene.loads is not None:
        case["forces"] = {
            name: _written_vector(f"loads.{name}", value)
            for name, value in vars(scene.loads).items()
            if callable(value) or np.any(value)
        }
    if scene.constraints is not None:
        case["constraints"] = {
            name: FREE if value is None else _written_vector(f"constraints.{other}", value)
            for name, other in _BOUND.items()
            for value in [getattr(scene.constraints, other)]
        }
    rows: dict[str, Array] = {
        "body.stokes_number": scene.stokes_number,
        "start.position": scene.position,
        "start.orientation": scene.quaternion,
    }
    for name in ("velocity", "angular_velocity"):
        if getattr(scene, name) is not None:
            rows[f"start.{name}"] = getattr(scene, name)
    if scene.lanes:
        case["sweep"] = {"axes": [{key: values.tolist() for key, values in rows.items()}]}
        return case
    case["body"]["stokes_number"] = float(scene.stokes_number[0])
    case["start"] = {
        name.partition(".")[2]: values[0].tolist()
        for name, values in rows.items()
        if name.startswith("start.")
    }
    case["start"]["orientation"] = {"quaternion": case["start"]["orientation"]}
    return case


def coupled_case(scene: CoupledSimulation, times: ArrayLike | None = None) -> dict[str, Any]:
    """As `to_case`, of bodies that share a fluid, or of one by a wall."""
    members = [_member(scene, index) for index in range(len(scene))]
    tolerances = {"hydrodynamics": scene.suspension.tolerance, "time": scene.tolerance}
    case: dict[str, Any] = {
        "task": "motion",
        **{section: {"tolerance": value} for section, value in tolerances.items()},
    }
    if scene.several:
        case["bodies"] = members
    else:
        (one,) = members
        case |= {name: one.pop(name) for name in ("start", "forces") if name in one}
        case["body"] = {name: value for name, value in one.items() if name != "size"}
        if one["size"] != 1.0:
            raise SceneError("bodies", "is one with a size", "a list of one body")
    if scene.flow is not None:
        case["flow"] = _flow_keys(scene.flow)
    wall, push = scene.suspension.wall, scene.repulsion
    if wall is not None:
        case["surroundings"] = {"type": "wall", **_plain(vars(wall))}
    if push is not None:
        case["repulsion"] = {"strength": push.strength, "range": push.range}
    if scene.table is not None:
        case["hydrodynamics"]["solve"] = "functional"
    watched = {"clearance": scene.events.clearance, "turning_points": scene.events.turning_points}
    if given := {name: _plain(value) for name, value in watched.items() if value}:
        case["events"] = given
    if times is not None:
        case["time"]["at"] = np.asarray(times, dtype=float).tolist()
    return case


def _member(scene: CoupledSimulation, index: int) -> dict[str, Any]:
    """The keys of one of the bodies."""
    body = scene.suspension.bodies[index]
    start: dict[str, Any] = {
        "position": scene.position[index].tolist(),
        "orientation": {"quaternion": scene.quaternion[index].tolist()},
    }
    for name in ("velocity", "angular_velocity"):
        values = getattr(scene, name)
        if values is not None:
            start[name] = np.broadcast_to(values, (len(scene), 3))[index].tolist()
    found = {
        **_shape_keys(body.shape),
        "size": float(body.size),
        "stokes_number": float(body.stokes_number),
        "start": start,
    }
    loads = {} if scene.loads is None else vars(scene.loads)
    forces = {
        name: _written_vector(f"loads.{name}", value if callable(value) else rows[index])
        for name, value in loads.items()
        if callable(value) or np.any(value)
        for rows in [value if callable(value) else np.broadcast_to(value, (len(scene), 3))]
    }
    return found | ({"forces": forces} if forces else {})


def _shape_keys(shape: Shape) -> dict[str, Any]:
    short = isinstance(shape, Spheroid)
    return {**shape.parameters} if short else {"shape": shape.spec()}


def _flow_keys(flow: Flow) -> dict[str, Any]:
    keys = _plain(flow.spec())
    if not all(entry is None or isinstance(entry, str | int | float) for entry in _entries(keys)):
        right = "a function in a file, FILE.py:NAME, or a file of a series"
        raise SceneError("flow", "holds a Python function, which no file holds", right)
    return dict(keys)


def _entries(keys: Any) -> Iterator[Any]:
    """What stands in a specification, at any depth."""
    if isinstance(keys, list | dict):
        for entry in keys.values() if isinstance(keys, dict) else keys:
            yield from _entries(entry)
    else:
        yield keys


def _written_vector(name: str, value: Any) -> list[float]:
    if callable(value):
        right = "numbers, expressions in t, a table, or FILE.py:NAME in a case"
        raise SceneError(name, "is a Python function, which no file holds", right)
    if np.ndim(value) > 1:
        raise SceneError(name, "differs from lane to lane", "the same for all lanes")
    return [float(part) for part in np.asarray(value)]


def _plain(value: Any) -> Any:
    """Arrays and tuples as lists."""
    if isinstance(value, Mapping):
        return {name: _plain(entry) for name, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value
