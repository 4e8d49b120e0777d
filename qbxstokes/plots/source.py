"""What pictures are drawn from: results by name, with the signs and units of their quantities."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from qbxstokes.errors import ResultFileError, SceneError
from qbxstokes.geometry import rotation
from qbxstokes.geometry.registry import SHAPE_KEYS, build_shape
from qbxstokes.typing import AnyArray, Array

# Samples of a path up to which it is drawn by so many points for each.
_FEW, _FINER = 2000, 8
TURN_LIMIT = 1.0  # radians between samples, beyond which a picture need not resemble the motion


class ResultLike(Protocol):
    """What `qbxstokes.load` returns, as far as pictures need it."""

    path: Path
    task: str
    arrays: Mapping[str, AnyArray]
    attributes: dict[str, dict[str, Any]]
    summary: dict[str, Any]
    provenance: dict[str, Any]
    groups: dict[str, dict[str, Any]]


def units(result: ResultLike, name: str) -> str:
    """Units of a dataset as the file states them."""
    return str(result.attributes.get(name, {}).get("units", ""))


def samples(result: ResultLike, name: str, width: int | None = None) -> Array:
    """Dataset `name` as floats, one row per instant.

    `width` is the number of components it must have (None: it is a number per instant). Raises
    ResultFileError where the file holds something else under that name.
    """
    values = np.asarray(result.arrays[name])
    shape = (len(result.arrays["time"]),) if width is None else (len(result.arrays["time"]), width)
    if values.shape != shape or values.dtype.kind not in "fiu":
        raise ResultFileError(
            f"{result.path}: {name} has shape {values.shape} and type {values.dtype}, "
            f"not {shape} numbers"
        )
    return values.astype(float)


def vectors(result: ResultLike, name: str) -> Array | None:
    """Dataset `name` (T, 3), None where the file does not hold it."""
    return samples(result, name, 3) if name in result.arrays else None


def instants(result: ResultLike) -> Array:
    """The times of the samples (T,); raises ResultFileError unless they are numbers that rise."""
    times = np.asarray(result.arrays["time"])
    if times.ndim != 1 or not times.size or times.dtype.kind not in "fiu":
        raise ResultFileError(f"{result.path}: holds no samples in time")
    if not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0.0):
        raise ResultFileError(f"{result.path}: the times of its samples do not rise")
    return times.astype(float)


def turn_between(result: ResultLike) -> float:
    """How far the axis turns between two samples where it turns fastest, radians; 0: not known.

    By its rate, where the file holds it: samples far apart may see a turn as none.
    """
    if not is_motion(result) or "axis" not in result.arrays or len(result.arrays["time"]) < 2:
        return 0.0
    if result.arrays["axis"].ndim == 3:  # of several bodies, drawn as they are
        return 0.0
    times, axis = instants(result), samples(result, "axis", 3)
    spin = vectors(result, "angular_velocity")
    if spin is None:
        cosine = np.abs(np.einsum("ij,ij->i", axis[1:], axis[:-1]))
        return float(np.nanmax(np.arccos(np.minimum(cosine, 1.0))))
    rates = np.linalg.norm(np.cross(spin, axis), axis=1)
    return float(np.nanmax(np.maximum(rates[1:], rates[:-1]) * np.diff(times)))


def sampling(result: ResultLike) -> str:
    """What is said of samples too far apart to draw; nothing where they are near enough."""
    turn = turn_between(result)
    if turn <= TURN_LIMIT:
        return ""
    wanted = int(np.ceil((len(result.arrays["time"]) - 1) * turn / 0.3)) + 1
    return (
        f"{2.0 * np.pi / turn:.2g} samples per turn where the axis turns fastest, so that patterns "
        f"may not be real; time.samples of {wanted} would do"
    )


def is_motion(result: ResultLike) -> bool:
    """Whether the result is one trajectory: times, and quantities sampled at them."""
    return result.task == "motion" and "time" in result.arrays


def resolved_case(result: ResultLike) -> Mapping[str, Any]:
    """The case that made the result, every default filled in; empty where it is not recorded."""
    try:
        case = json.loads(result.provenance.get("resolved_case", "{}"))
    except (TypeError, ValueError):
        return {}
    return case if isinstance(case, dict) else {}


def shapes_of(result: ResultLike, count: int = 1) -> list[tuple[Any, float]]:
    """Shape and size of every body; raises ResultFileError where the file does not say.

    Of a trajectory of a sweep a shape may be a swept value, which its provenance names.
    """
    case, swept = resolved_case(result), result.provenance.get("swept", {})
    try:
        found = []
        for entry in case.get("bodies") or [case.get("body") or {}]:
            given = {name: entry.get(name) for name in SHAPE_KEYS}
            if isinstance(swept, dict) and not case.get("bodies"):
                given |= {name: value for name, value in swept.items() if name in SHAPE_KEYS}
            found.append((build_shape(**given), entry.get("size", 1.0)))
    except (SceneError, TypeError, AttributeError):
        found = []
    if len(found) != count:
        raise ResultFileError(f"{result.path}: does not say the shapes of the bodies")
    return found


def coupled(result: ResultLike) -> bool:
    """Whether the result is a motion of several bodies, or of one by a wall."""
    return bool(resolved_case(result).get("bodies")) or wall_of(result) is not None


def wall_of(result: ResultLike) -> tuple[Array, Array] | None:
    """Unit normal and a point of the wall, None where there is none."""
    around = resolved_case(result).get("surroundings") or {}
    if around.get("type") != "wall":
        return None
    normal = np.array(around["normal"], dtype=np.float64)
    return normal / np.linalg.norm(normal), np.array(around["point"], dtype=np.float64)


# -- fields: what one holds at an instant, where the bodies are, how coordinates are called -----


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
    bodies = shapes_of(result, count)
    return [
        Member(shape, size, x, rotation.matrix(q), v, w)
        for (shape, size), x, q, v, w in zip(bodies, *held, strict=True)
    ]


def surfaces_of(field: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The surfaces that the field holds, in the order of the bodies."""
    names = [name for name in field if name == "surface" or name.startswith("surface_")]
    return [field[name] for name in sorted(names, key=lambda name: (len(name), name))]


# -- between the samples: files hold quantities with their rates, so that the cubic through both is
# of fourth order in their distance --------------------------------------------------------------


def between(times: Array, values: Array, rates: Array | None, at: Array) -> Array:
    """Values (m, d) at the times `at` (m,) inside `times` (n,), from samples (n, d).

    Cubic Hermite interpolation with the rates (n, d), linear where there are none.
    """
    if len(times) == 1:
        return np.repeat(values, len(at), axis=0)
    index = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    step = (times[index + 1] - times[index])[:, None]
    s = (at[:, None] - times[index, None]) / step
    change = values[index + 1] - values[index]
    point: Array = values[index] + s * change
    if rates is not None:
        first, last = step * rates[index] - change, change - step * rates[index + 1]
        point = point + s * (1.0 - s) * ((1.0 - s) * first + s * last)
    return point


def smooth(times: Array, points: Array, rates: Array | None) -> Array:
    """Paths (T, ..., 3) with points between the samples, where rates agree with these."""
    if rates is None or rates.shape != points.shape or not 1 < len(times) <= _FEW:
        return points
    n, last = len(times), len(times) - 1
    at = np.interp(np.arange(_FINER * last) / _FINER, np.arange(n), times)
    flat, slopes = points.reshape(n, -1, 3), rates.reshape(n, -1, 3)
    change, step = np.diff(flat, axis=0), np.diff(times)[:, None, None]
    off = [np.linalg.norm(step * v - change, axis=2) for v in (slopes[:-1], slopes[1:])]
    sure = np.maximum(*off) < np.linalg.norm(change, axis=2)
    chords, curves = (
        between(times, flat.reshape(n, -1), given, at).reshape(-1, *flat.shape[1:])
        for given in (None, slopes.reshape(n, -1))
    )
    inner = np.where(np.repeat(sure, _FINER, axis=0)[..., None], curves, chords)
    return np.concatenate([inner, flat[-1:]]).reshape(-1, *points.shape[1:])


def axis_path(times: Array, axis: Array, spin: Array | None) -> tuple:
    """Times (m,) and axes (m, 3), with steps of at most about a twentieth of a radian.

    axis (n, 3) are unit vectors, spin (n, 3) the angular velocity in the same frame: the rate of
    the axis is their cross product. Rates are used where samples are less than a radian apart.
    """
    if len(times) < 2:
        return times, axis
    cosine = np.einsum("ij,ij->i", axis[:-1], axis[1:])
    angle = np.arctan2(np.linalg.norm(np.cross(axis[:-1], axis[1:]), axis=1), cosine)
    counts = np.clip(np.ceil(angle / 0.05), 1, 80).astype(int)
    index = np.repeat(np.arange(len(counts)), counts)
    part = np.arange(len(index)) - np.repeat(np.cumsum(counts) - counts, counts)
    at = times[index] + (times[index + 1] - times[index]) * part / counts[index]
    at = np.append(at, times[-1])
    point = between(times, axis, None, at)
    if spin is not None:
        smooth = between(times, axis, np.cross(spin, axis), at)
        close = np.append(angle[index] < TURN_LIMIT, True)
        point = np.where(close[:, None], smooth, point)
    length = np.linalg.norm(point, axis=1, keepdims=True)
    return at, point / np.maximum(length, 1e-12)
