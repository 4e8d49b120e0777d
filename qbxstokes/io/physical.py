"""A result with its arrays in physical units, by the scales that its case gives."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import ResultFileError
from qbxstokes.io.listing import LazyArrays, units_in_groups
from qbxstokes.typing import AnyArray
from qbxstokes.units import Scales

if TYPE_CHECKING:
    from qbxstokes.io.results import Result


def physical(result: Result) -> Result:
    """See `Result.in_units`."""
    given = result.provenance.get("units")
    if not given:
        right = "a section `units` in the case gives them"
        raise ResultFileError(f"{result.path}: holds no physical scales; {right}")
    scales = Scales(given)

    def converted(name: str) -> AnyArray:
        convert = _table if name == "table" else _array
        return convert(result.arrays[name], result.attributes[name], scales)

    found = copy.copy(result)
    found.original, found.arrays = result, LazyArrays(result.shapes, converted)
    found.attributes = {name: _told(about, scales) for name, about in result.attributes.items()}
    found.groups = _group(result.groups, scales)
    found.converted_by = scales
    _, _, rest = result.conventions.partition(" Orientation:")
    found.conventions = f"Physical units, told with every array. Orientation:{rest}"
    return found


def shown(units: Any, scales: Scales) -> tuple[float, str] | None:
    """Factor and physical unit for units of this program; None where there are none."""
    scale = scales.scale(str(units))
    return None if scale is None else scales.shown(scale)


def _array(data: AnyArray, about: Mapping[str, Any], scales: Scales) -> AnyArray:
    units = str(about.get("units", ""))
    pair = _matrix(units, scales)
    if pair is not None and data.ndim > 1 and data.shape[-1] == data.shape[-2]:
        parts = np.sqrt(np.tile(np.repeat([pair[0][0], pair[1][0]], 3), data.shape[-1] // 6))
        return data * np.outer(parts, parts)
    found = shown(units, scales)
    return data if found is None else data * found[0]


def _matrix(units: str, scales: Scales) -> Any:
    """Factors and units of translation and rotation in a resistance or mobility, or None."""
    first = units.partition(", ")[0]
    if first == units or first not in ("mu c", "1/(mu c)"):
        return None
    pair = shown(first, scales), shown(first.replace("c", "c^3"), scales)
    return pair if all(pair) else None


def _table(data: AnyArray, about: Mapping[str, Any], scales: Scales) -> AnyArray:
    table = data.copy()
    for name in table.dtype.names or ():
        if found := shown(about.get(f"{name}: units", ""), scales):
            table[name] *= found[0]
    return table


def _told(about: Mapping[str, Any], scales: Scales) -> dict[str, Any]:
    """Attributes with physical units in the place of those of this program."""
    told = dict(about)
    for name, value in about.items():
        if name == "units" or name.endswith(": units"):
            pair, single = _matrix(str(value), scales), shown(value, scales)
            if pair or single:
                told[name] = ", ".join(unit for _, unit in pair or [single])
    return told


def _group(tree: Mapping[str, Any], scales: Scales) -> dict[str, Any]:
    """The arrays of nested groups, by what their names stand for."""
    found: dict[str, Any] = {}
    for name, value in tree.items():
        known = shown(units_in_groups(name), scales)
        if isinstance(value, Mapping):
            found[name] = _group(value, scales)
        elif known and isinstance(value, np.ndarray) and value.dtype.kind == "f":
            found[name] = value * known[0]
        else:
            found[name] = value
    return found
