"""What pictures are drawn from: results by name, with the signs and units of their quantities."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from qbxstokes.errors import ResultFileError

Array = NDArray[np.float64]


class ResultLike(Protocol):
    """What `qbxstokes.load` returns, as far as pictures need it."""

    path: Path
    task: str
    arrays: Mapping[str, NDArray[Any]]
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


def aspect_ratio(result: ResultLike) -> float:
    """Aspect ratio k of the body; raises ResultFileError where the file does not say.

    Of a trajectory of a sweep it may be a swept value, which its provenance names.
    """
    body = resolved_case(result).get("body", {})
    value = body.get("aspect_ratio") if isinstance(body, dict) else None
    swept = result.provenance.get("swept", {})
    if isinstance(swept, dict):
        value = swept.get("aspect_ratio", value)
    if not isinstance(value, (int, float)) or not 0.0 < value < np.inf:
        raise ResultFileError(f"{result.path}: does not say the aspect ratio of the body")
    return float(value)
