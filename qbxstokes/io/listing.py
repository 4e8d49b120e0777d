"""What a result holds, as a person reads it: names, shapes, units and meanings; physical units."""

from __future__ import annotations

import copy
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import ResultFileError
from qbxstokes.quantities import FLUID, HALF_TURN, INSTANT, MOTION, POINT, SURFACE, column
from qbxstokes.units import Scales

if TYPE_CHECKING:
    from qbxstokes.io.results import Result
    from qbxstokes.typing import AnyArray

Shape = tuple[int, ...]

# Of what stands in groups, the files' own attributes of which are not read.
KNOWN = {"time": INSTANT, **FLUID, **POINT, **SURFACE, **HALF_TURN}
_WIDTH = 100


def units_in_groups(name: str) -> str:
    """Units of an array in a group, by its name, '' where none are known."""
    known = KNOWN.get(name)
    return known.units if known else ""


class Held(Mapping[str, Any]):
    """Arrays by name, or groups of them, as items and attributes; it shows shapes and units.

    shapes, about: shapes and attributes of the arrays by name, where they are known beforehand;
    scales: by which those are converted of which a name alone tells the units.
    """

    def __init__(
        self,
        arrays: Mapping[str, Any],
        shapes: Mapping[str, Shape] | None = None,
        about: Mapping[str, Mapping[str, Any]] | None = None,
        scales: Scales | None = None,
    ) -> None:
        self._arrays, self._shapes, self._about = arrays, shapes or {}, about or {}
        self._scales = scales

    def __getitem__(self, name: str) -> Any:
        value = self._arrays[name]
        return Held(value, scales=self._scales) if isinstance(value, Mapping) else value

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("_") and name in self._arrays:
            return self[name]
        raise AttributeError(f"no {name}; there are {', '.join(self)}")

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self]

    def units(self, name: str) -> str:
        """Units of an array, '' where none are known."""
        if "units" in self._about.get(name, {}):
            return str(self._about[name]["units"])
        units = units_in_groups(name)
        shown = self._scales.shown(units) if self._scales else None
        return shown[1] if shown else units

    def told(self, name: str) -> str:
        """An array's name with its units."""
        units = self.units(name)
        return f"{name} [{units}]" if units else name

    def lines(self, prefix: str = "") -> Iterator[str]:
        """A line for each array: name, units and shape."""
        for name in self:
            if name in self._shapes or not isinstance(self[name], Held):
                shape = self._shapes.get(name) or np.shape(self[name])
                yield f"{prefix + self.told(name):40} {shape}"
            else:
                yield from self[name].lines(f"{prefix}{name}.")

    def __repr__(self) -> str:
        return "\n".join(self.lines()) or "nothing"


class LazyArrays(Mapping[str, Any]):
    """Arrays of known shapes by name, each made by `read` when it is first used."""

    def __init__(self, shapes: Mapping[str, Shape], read: Callable[[str], Any]) -> None:
        self.shapes, self._read = dict(shapes), read
        self._held: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._held:
            self.shapes[name]  # KeyError, if there is none
            self._held[name] = self._read(name)
        return self._held[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.shapes)

    def __len__(self) -> int:
        return len(self.shapes)


def holds(result: Result) -> dict[str, list[tuple[str, str]]]:
    """Rows of name and text by heading: datasets, events, sets of points, columns of a table."""
    found: dict[str, list[tuple[str, str]]] = {"Holds": [], "Events": [], "Fields": [], "Table": []}
    for name, shape in result.shapes.items():
        about = result.attributes.get(name, {})
        units = f" [{about['units']}]" if about.get("units") else ""
        size = "x".join(map(str, shape))
        found["Holds"].append((f"{name} {size}".strip(), f"{about.get('description', '')}{units}"))
    for heading, groups in (
        ("Events", result.events),
        ("Fields", Held(result.sets, scales=result.converted_by)),
    ):
        for name, held in groups.items():
            if isinstance(held, Held):
                sizes = [np.shape(held[n]) for n in ("points", "time") if n in held]
                shape = sizes[0][:-1] or sizes[0] if sizes else ()
                size = "x".join(map(str, shape))
                arrays = [held.told(n) for n in held if np.ndim(held[n])]
                found[heading].append((f"{name} {size}".strip(), ", ".join(arrays)))
    if "table" in result.shapes:
        for name in result.arrays["table"].dtype.names or ():
            known = column(name)
            units = result.attributes["table"].get(f"{name}: units", known.units)
            units = f" [{units}]" if units else ""
            found["Table"].append((name, f"{known.description}{units}".strip()))
    return found


_FEW = (
    "{} of the axis (a longer time.end, a smaller sweep.discard), an axis that has come to lie "
    "along the vorticity, or samples too far apart to count turns (more time.samples)"
)
_SHEAR = "the flow at the start is no simple shear"
# Why a column of a table is not known of a trajectory that was done.
_WHY = {
    "period": _FEW.format("no whole half-turn"),
    "rotation_rate": _FEW.format("no whole half-turn"),
    "period_change": _FEW.format("fewer than two half-turns"),
    "velocity_change": _FEW.format("fewer than two half-turns"),
    "orbit_drift": f"no half-turn that the samples tell, a tumbling axis, or {_SHEAR}",
    "orbit_constant": _SHEAR,
    "jeffery_period": "the flow at the start turns no axis",
}


def unknown(table: AnyArray, columns: Sequence[str] = ()) -> list[str]:
    """Which columns of the table of a sweep are not known (NaN) of how many, and why.

    columns: those that are looked at; () for all.
    """
    there = table.dtype.names or ()
    if "status" not in there:
        return []
    done = table[table["status"] == 1]
    found: dict[tuple[str, int], list[str]] = {}
    for name in columns or there:
        why = next((text for start, text in _WHY.items() if name == start), "") or next(
            (text for start, text in _WHY.items() if name.startswith(f"{start}_")), ""
        )
        if why and name in there and (count := int(np.isnan(done[name]).sum())):
            found.setdefault((why, count), []).append(name)
    return [
        f"{', '.join(names)}: not known of {count} of {len(done)} trajectories: {why}"
        for (why, count), names in found.items()
    ]


def units_of(name: str) -> str:
    """Units of an entry of a summary, by its dotted name; '' where they are none."""
    first, _, last = name.rpartition(".")
    if first == "wall_times" or last in ("wall_time", "setup_time"):
        return "s"
    last = last.removeprefix("final_").removeprefix("last_").removesuffix("_per_period")
    units = (MOTION.get(last) or HALF_TURN.get(last) or column(last)).units
    return "" if units == "1" or first == "errors" else units


def listing(result: Result) -> str:
    """The result in some lines: what it holds with shapes, units and meanings, its summary."""
    title = result.provenance.get("title") or ""
    lines = [f"<{result.task} result {result.path}{': ' if title else ''}{title}>"]
    rows = holds(result)
    width = max(len(label) for label, _ in rows["Holds"]) if rows["Holds"] else 0
    lines += [f"  {label:{width}}  {text}" for label, text in rows["Holds"]]
    groups = [(key.lower(), row) for key in ("Events", "Fields") for row in rows[key]]
    wrapped = [(f"{key}.{label}", text) for key, (label, text) in groups]
    wrapped.append(("table", ", ".join(label for label, _ in rows["Table"])))
    wrapped.append(("summary", ", ".join(result.summary)))
    for label, text in wrapped:
        if text:
            whole = f"  {label}: {text}"
            lines.append(textwrap.fill(whole, _WIDTH, subsequent_indent="    "))
    return "\n".join(lines)


# -- in physical units -----------------------------------------------------------------------------


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


def _array(data: AnyArray, about: Mapping[str, Any], scales: Scales) -> AnyArray:
    units = str(about.get("units", ""))
    pair = _matrix(units, scales)
    if pair is not None and data.ndim > 1 and data.shape[-1] == data.shape[-2]:
        parts = np.sqrt(np.tile(np.repeat([pair[0][0], pair[1][0]], 3), data.shape[-1] // 6))
        return data * np.outer(parts, parts)
    found = scales.shown(units)
    return data if found is None else data * found[0]


def _matrix(units: str, scales: Scales) -> Any:
    """Factors and units of translation and rotation in a resistance or mobility, or None."""
    first = units.partition(", ")[0]
    if first == units or first not in ("mu c", "1/(mu c)"):
        return None
    pair = scales.shown(first), scales.shown(first.replace("c", "c^3"))
    return pair if all(pair) else None


def _table(data: AnyArray, about: Mapping[str, Any], scales: Scales) -> AnyArray:
    table = data.copy()
    for name in table.dtype.names or ():
        if found := scales.shown(about.get(f"{name}: units", "")):
            table[name] *= found[0]
    return table


def _told(about: Mapping[str, Any], scales: Scales) -> dict[str, Any]:
    """Attributes with physical units in the place of those of this program."""
    told = dict(about)
    for name, value in about.items():
        if name == "units" or name.endswith(": units"):
            pair, single = _matrix(str(value), scales), scales.shown(value)
            if pair or single:
                told[name] = ", ".join(unit for _, unit in pair or [single])
    return told


def _group(tree: Mapping[str, Any], scales: Scales) -> dict[str, Any]:
    """The arrays of nested groups, by what their names stand for."""
    found: dict[str, Any] = {}
    for name, value in tree.items():
        known = scales.shown(units_in_groups(name))
        if isinstance(value, Mapping):
            found[name] = _group(value, scales)
        elif known and isinstance(value, np.ndarray) and value.dtype.kind == "f":
            found[name] = value * known[0]
        else:
            found[name] = value
    return found
