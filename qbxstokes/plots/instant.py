"""What a field holds at an instant: where the bodies are, and how coordinates are called."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from qbxstokes.geometry import rotation
from qbxstokes.plots.bodies import coupled, outlines
from qbxstokes.plots.picture_source import ResultLike, shape_of
from qbxstokes.typing import Array


def name_of(plane: Mapping[str, Any], which: str) -> str:
    """How a coordinate of the plane is called: by the axis it runs along, where it does."""
    direction = plane[which]
    for index in range(3):
        if abs(direction[index] - 1.0) < 1e-12:
            frame = plane["frame"]
            if frame == "body":
                return rf"$\tilde{{x}}_{index + 1}$"
            place = f" - X_{index + 1}" if frame == "centre" else ""
            return f"$x_{index + 1}{place}$"
    return f"{which} coordinate"


def state(result: ResultLike, step: int, name: str) -> Array:
    """Quantity of the body at an instant of the field."""
    times = np.asarray(result.arrays["time"])
    instant = result.groups["field"]["time"][step]
    return np.asarray(np.asarray(result.arrays[name])[int(np.abs(times - instant).argmin())])


def view_of(result: ResultLike, field: Mapping[str, Any], step: int) -> tuple[Array, Array]:
    """Directions across and up the picture of the body: those of the plane, if there is one."""
    if "plane" in field:
        return directions(result, field["plane"], step)
    axis = np.atleast_2d(state(result, step, "axis"))[0]
    across = np.eye(3)[int(np.abs(axis).argmin())]
    second = np.cross(axis, across)
    return axis, second / np.linalg.norm(second)


def directions(result: ResultLike, plane: Mapping[str, Any], step: int) -> tuple[Array, Array]:
    """Directions of the plane's coordinates in space."""
    first, second = plane["first"], plane["second"]
    if plane["frame"] == "body":
        turn = rotation.matrix(state(result, step, "orientation"))
        return turn @ first, turn @ second
    return first, second


@dataclass(frozen=True)
class Member:
    """A body at an instant: shape, size, and its motion in space."""

    shape: Any
    size: float
    position: Array
    turn: Array
    velocity: Array
    angular_velocity: Array


def members_of(result: ResultLike, step: int) -> list[Member]:
    """The bodies at an instant of the field."""
    names = "position", "orientation", "velocity", "angular_velocity"
    held = [np.atleast_2d(state(result, step, name)) for name in names]
    count = len(held[0])
    bodies = outlines(result, count) if coupled(result) else [(shape_of(result), 1.0)]
    return [
        Member(shape, size, x, rotation.matrix(q), v, w)
        for (shape, size), x, q, v, w in zip(bodies, *held, strict=True)
    ]


def surfaces_of(field: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The surfaces that the field holds, in the order of the bodies."""
    names = [name for name in field if name == "surface" or name.startswith("surface_")]
    return [field[name] for name in sorted(names, key=lambda name: (len(name), name))]
