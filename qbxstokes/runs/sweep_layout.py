"""What the result of a sweep holds: columns of its table, quantities, scales."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.case.space import column_name
from qbxstokes.io.sweep import REASON_LENGTH, Layout
from qbxstokes.quantities import PARAMETER, STATUS, Quantity
from qbxstokes.runs.bodies import Swept

Array = NDArray[Any]

_COORDINATE_PIECE = 65_536


def layout_of(scenes: Swept) -> Layout:
    """What the result file holds."""
    coordinates = _coordinate_types(scenes)
    columns: list[tuple[str, Any]] = [*coordinates.items()]
    columns += [("status", "i1"), *((name, "f8") for name in scenes.columns)]
    columns += [("reason", f"S{REASON_LENGTH}")]
    swept = {
        name: PARAMETER.get(name) or Quantity(name, "", "", f"swept value {name}")
        for name in coordinates
    }
    return Layout(
        scenes.space.size,
        scenes.samples,
        np.dtype(columns),
        scenes.quantities,
        scenes.common_times,
        tuple(coordinates),
        {**swept, **STATUS, **scenes.columns},
    )


def _coordinate_types(scenes: Swept) -> dict[str, Any]:
    """Columns of the swept values and their types; vectors one column per component."""
    types: dict[str, Any] = {}
    for _, column in scenes.space.columns:
        name = column_name(column.key)
        sample = column.take(np.arange(min(column.size, 1)))
        if not column.numeric:
            assert column.values is not None
            words = [_word(value) for value in column.values.tolist()]
            types[name] = f"S{max(1, *(len(word) for word in words))}"
        elif sample.ndim == 1:
            types[name] = "f8"
        else:
            first = 0 if sample.shape[1] == 4 else 1
            types |= {f"{name}_{i + first}": "f8" for i in range(sample.shape[1])}
    return types


def _word(value: Any) -> bytes:
    text = value if isinstance(value, str) else json.dumps(value)
    return text.encode("ascii", "backslashreplace")


def coordinates_of(scenes: Swept, index: Array) -> dict[str, Array]:
    """Swept values of some trajectories as columns."""
    columns: dict[str, Array] = {}
    by_key = {column.key: column for _, column in scenes.space.columns}
    for key, values in scenes.space.values(index).items():
        name = column_name(key)
        if not by_key[key].numeric:
            columns[name] = np.array([_word(value) for value in values.tolist()])
        elif values.ndim == 1:
            columns[name] = values
        else:
            first = 0 if values.shape[1] == 4 else 1
            columns |= {f"{name}_{i + first}": values[:, i] for i in range(values.shape[1])}
    return columns


def scales_of(scenes: Swept, layout: Layout) -> Iterator[tuple[int, dict[str, Array]]]:
    """The scales of the file in pieces."""
    for first in range(0, layout.size, _COORDINATE_PIECE):
        index = np.arange(first, min(first + _COORDINATE_PIECE, layout.size))
        columns = coordinates_of(scenes, index)
        yield (
            first,
            {
                "trajectory": index,
                **{name: values.astype(layout.dtype[name]) for name, values in columns.items()},
            },
        )
    if layout.quantities and layout.times is not None:
        yield 0, {"time": layout.times}
    elif layout.quantities:
        yield 0, {"sample": np.arange(layout.samples)}
