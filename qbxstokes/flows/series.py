"""Velocity gradients along paths, from samples: in memory, in files, or made at random."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError
from qbxstokes.flows.interpolation import Series, power_weights
from qbxstokes.flows.samples import Samples, in_file, in_rows, random_samples, view
from qbxstokes.flows.user import resolve_paths
from qbxstokes.flows.values import SINGLE, check_keys, number, whole
from qbxstokes.tables import HDF5, TableError, check_file, read_table
from qbxstokes.typing import Array, Integers

TRACES = "project", "error"
_RULES = "interpolation", "trace", "outside"


class GradientSeries(Series):
    """Velocity gradients A(t) from samples: times (T,), gradients (..., T, 3, 3) or (..., T, 9).

    The nine components are by rows, du1/dx1 du1/dx2 ...; eight leave out the last, which follows
    from div u = 0. interpolation and outside as in `Series`. trace: "project" takes a third of the
    trace off the diagonal and `trace` tells its largest size relative to |A|; "error" refuses.
    """

    def __init__(
        self,
        times: ArrayLike,
        gradients: Any,
        *,
        interpolation: str = "sextic",
        trace: str = "project",
        outside: str = "error",
    ) -> None:
        if trace not in TRACES:
            raise FlowError(f"trace is one of {', '.join(TRACES)}, not {trace!r}", ("trace",))
        a = gradients if hasattr(gradients, "shape") else np.asarray(gradients, dtype=np.float64)
        if isinstance(a, np.ndarray) and a.shape[-2:] == (3, 3):
            a = a.reshape(*a.shape[:-2], 9)
        super().__init__(times, a, interpolation=interpolation, outside=outside)
        if self.samples.shape[-1] not in (8, 9):
            right = self._shapes(len(self.times))
            raise FlowError(f"gradients have shape {a.shape}; {right} is expected", ("gradient",))
        self.trace_rule, self.trace = trace, 0.0

    name = "gradients"

    def _shapes(self, count: int) -> str:
        return f"(..., {count}, 3, 3), (..., {count}, 9) or (..., {count}, 8)"

    def __call__(self, t: float) -> Array:
        """A (3, 3) at an instant, of a series of one path."""
        return super().__call__(t).reshape(3, 3)

    @classmethod
    def from_file(cls, file: str | Path, **keys: Any) -> GradientSeries:
        """Of an HDF5, netCDF-4, NPY or CSV file, by the keys of `series_of_file`."""
        return series_of_file({"file": str(file), **keys})

    @classmethod
    def gaussian(cls, **keys: Any) -> GradientSeries:
        """Paths at random (`samples`): end, spacing, paths, rate, correlation_time, ..."""
        return series_of_file({"process": "gaussian", **keys})

    @property
    def intervals(self) -> tuple[Array, Integers, Array]:
        """Ends of intervals, first samples of their windows, and weights (`power_weights`)."""
        return self.times, *power_weights(self.times, self.interpolation)

    def typical(self, paths: int) -> Array:
        """Gradients (n, 9) of which the size is typical: of the first paths, at both ends."""
        ends = [self.read(0, paths, t, t + 1) for t in (0, len(self.times) - 1)]
        return np.concatenate(ends).reshape(-1, 9)

    def thinned(self) -> GradientSeries:
        """The same of every other sample."""
        return self._with(self.times[::2], self._rows[:, ::2])

    def path(self, number: int) -> GradientSeries:
        """The series of one path, by its number in the order of the leading axes."""
        if not 0 <= number < len(self):
            raise FlowError(f"trajectory {number} of {len(self)}", ("trajectory",))
        return self._with(self.times, self._rows[number, slice(None)])

    def chosen(self, numbers: Integers) -> GradientSeries:
        """Some of the paths, by their numbers, in their order."""
        if np.array_equal(numbers, np.arange(len(self))):
            return self
        return self._with(self.times, view(self._rows, numbers, 0, len(self.times)))

    def part(self, paths: slice, instants: slice) -> GradientSeries:
        """Some of the paths, by their numbers, at some of the instants; nothing is read."""
        first, last, _ = instants.indices(len(self.times))
        numbers = None if paths == slice(None) else np.arange(*paths.indices(len(self)))
        return self._with(self.times[first:last], view(self._rows, numbers, first, last))

    def _with(self, times: Array, samples: Any) -> GradientSeries:
        rules = {"interpolation": self.interpolation, "trace": self.trace_rule}
        return GradientSeries(times, samples, outside=self.outside, **rules)

    def read(self, first: int, stop: int, begin: int = 0, end: int | None = None) -> Array:
        """Samples begin to end (stop - first, T, 9) of some paths, traceless.

        Raises FlowError for what is no number.
        """
        a = super().read(first, stop, begin, end)
        if a.shape[-1] == 8:
            a = np.concatenate([a, -(a[..., :1] + a[..., 4:5])], axis=-1)
        size = max(float(np.max(a, initial=0.0)), -float(np.min(a, initial=0.0)))
        third = (a[..., 0] + a[..., 4] + a[..., 8]) / 3.0
        self.trace = max(self.trace, 3.0 * float(np.abs(third).max()) / size if size else 0.0)
        if self.trace_rule == "error" and self.trace > SINGLE:
            raise FlowError(f"the gradients have a trace, {self.trace:.3g} of their size")
        for i in (0, 4, 8):
            a[..., i] -= third
        return a


def series_of_file(given: Mapping[str, Any], trajectory: int | None = None) -> GradientSeries:
    """The series of {file, dataset, time, layout, rows, unit, interpolation, trace, outside}.

    HDF5 and netCDF-4: datasets by name, gradients mapped as they come, `layout` the order of their
    axes, [trajectory, time] or [time, trajectory]; both follow from dimensions with names, and that
    of one path needs none. Where paths follow one another in a dataset (n, 9), `rows` is that of
    their lengths (`rowsize` of CF's contiguous ragged arrays); they are taken as far as the
    shortest, with the same times, or one alone, the trajectory. CSV and NPY: rows of t and eight or
    nine components, one path; or NPY of many paths, mapped, with `time` the NPY file of the
    instants beside it. unit: the flow's unit of time in that of the file, by which times are
    divided and gradients multiplied.
    With {process: gaussian, rate, correlation_time, paths, end, spacing, seed} the paths are made
    at random (`samples`); with {times, values} they are given. Raises FlowError.
    """
    try:
        if "times" in given:
            return _of_numbers(given)
        return _of_process(given) if "process" in given else _of_file(given, trajectory)
    except FlowError as error:
        if error.key[:1] in (("gradient",), ("trajectory",)):
            raise
        raise FlowError(str(error), ("gradient", *error.key)) from None


def _of_numbers(given: Mapping[str, Any]) -> GradientSeries:
    rules = {name: given[name] for name in _RULES if name in given}
    check_keys(given, ["times", "values", *rules], "linear")
    try:
        values = np.asarray(given.get("values"), dtype=np.float64)
        return GradientSeries(np.asarray(given["times"], dtype=np.float64), values, **rules)
    except (TypeError, ValueError) as error:
        right = "{times: [...], values: [...]} of instants and gradients"
        raise FlowError(f"gradient: {error}; {right} is expected", ("gradient",)) from None


def _of_file(given: Mapping[str, Any], trajectory: int | None) -> GradientSeries:
    known = ["file", "dataset", "time", "layout", "rows", "unit", *_RULES]
    check_keys(given, known, "linear")
    rules = {name: given[name] for name in _RULES if name in given}
    unit = number(given.get("unit", 1.0), "unit", positive=True)
    path = Path(str(given.get("file", "")))
    try:
        check_file(path)
    except TableError as error:
        raise FlowError(str(error), ("gradient", "file")) from None
    if path.suffix in HDF5:
        read = _of_rows(path, given, trajectory) if "rows" in given else _of_hdf5(path, given)
        times, samples = read
        return GradientSeries(times / unit, samples.times(unit), **rules)
    if path.suffix == ".npy" and "time" in given:
        times, samples = _of_npy(path, given)
        return GradientSeries(times / unit, samples.times(unit), **rules)
    try:
        numbers = read_table(path).numbers
    except TableError as error:
        raise FlowError(str(error), ("gradient", "file")) from None
    if numbers.shape[1] not in (9, 10):
        wrong = f"{path}: has {numbers.shape[1]} columns; t and 8 or 9 components are expected"
        raise FlowError(wrong, ("gradient", "file"))
    return GradientSeries(numbers[:, 0] / unit, unit * numbers[:, 1:], **rules)


def _of_process(given: Mapping[str, Any]) -> GradientSeries:
    defaults = {"rate": 1.0, "correlation_time": 1.0, "paths": 1000, "spacing": 0.1, "seed": 0}
    check_keys(given, ["process", "end", *defaults], "linear")
    if given["process"] != "gaussian":
        raise FlowError(f"process is gaussian, not {given['process']!r}", ("gradient", "process"))
    if "end" not in given:
        raise FlowError("end is missing: the time that the paths last", ("gradient", "end"))
    chosen = {name: given.get(name, value) for name, value in defaults.items()}
    end = number(given["end"], "end")
    rate, time, spacing = (number(chosen[n], n) for n in ("rate", "correlation_time", "spacing"))
    paths, seed = whole(chosen["paths"], "paths", 1), whole(chosen["seed"], "seed", 0)
    if not 0.0 < spacing <= 0.2 * end or end / spacing > 1e8:
        raise FlowError(f"spacing is {spacing:g}, and end {end:g}", ("gradient", "spacing"))
    times = np.linspace(0.0, end, round(end / spacing) + 1)
    return GradientSeries(times, random_samples(times, paths, rate, time, seed))


def _of_hdf5(path: Path, given: Mapping[str, Any]) -> tuple[Array, Any]:
    import h5py

    try:
        data = h5py.File(path, "r")[given.get("dataset", "A")]
        scale, order = _of_dimensions(data)
        times = scale if scale and "time" not in given else data.file[given.get("time", "t")]
        times = np.asarray(times[:], dtype=np.float64)
    except (OSError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise FlowError(f"{path}: cannot be read ({error})", ("gradient", "file")) from None
    return times, _laid_out(data, given, order)


def _of_npy(path: Path, given: Mapping[str, Any]) -> tuple[Array, Any]:
    try:
        data = np.load(path, mmap_mode="r", allow_pickle=False)
        times = np.load(path.parent / str(given["time"]), allow_pickle=False).astype(np.float64)
    except (OSError, ValueError, TypeError) as error:
        raise FlowError(f"{path}: cannot be read ({error})", ("gradient", "file")) from None
    return times, _laid_out(data, given, ["trajectory", "time"])


def _laid_out(data: Any, given: Mapping[str, Any], order: list[str]) -> Samples:
    """Samples of which the file tells the order of axes, or else the case."""
    layout = given.get("layout", order)
    named = tuple(layout) if isinstance(layout, (list, tuple)) else ()
    if named not in (("time", "trajectory"), ("trajectory", "time")):
        right = "[trajectory, time] or [time, trajectory]"
        raise FlowError(f"layout is {layout}; {right} is expected", ("gradient", "layout"))
    if data.ndim == 2 or (data.ndim == 3 and data.shape[1:] == (3, 3)):
        return in_file(data[...].reshape(1, len(data), -1), False)
    if data.ndim not in (3, 4):
        wrong = f"samples have shape {data.shape}; paths, instants and components are expected"
        raise FlowError(wrong, ("gradient", "file"))
    return in_file(data, layout[0] == "time")


def _of_rows(path: Path, given: Mapping[str, Any], trajectory: int | None) -> tuple[Array, Any]:
    import h5py

    try:
        data = h5py.File(path, "r")[given.get("dataset", "A")]
        file = data.file
        lengths = np.asarray(file[given["rows"]][:], dtype=np.int64)
        times = file[given.get("time", "t")]
        ends = np.cumsum(lengths)
        if ends[-1] != len(data) or len(times) != len(data) or lengths.min() < 1:
            wrong = f"{path}: {given['rows']} add up to {ends[-1]} samples of {len(data)}"
            raise FlowError(wrong, ("gradient", "rows"))
        starts, count = ends - lengths, int(lengths.min())
        if trajectory is not None:
            if not 0 <= trajectory < len(starts):
                raise FlowError(f"trajectory {trajectory} of {len(starts)}", ("trajectory",))
            starts, count = starts[[trajectory]], int(lengths[trajectory])
        instants = np.asarray(times[starts[0] : starts[0] + count], dtype=np.float64)
        for start in starts.tolist():
            own = times[start : start + count]
            if not np.allclose(own, instants, rtol=1e-9, atol=1e-9 * float(np.ptp(instants))):
                wrong = f"{path}: paths have times of their own; name a trajectory"
                raise FlowError(wrong, ("gradient", "rows"))
    except (OSError, KeyError, IndexError, ValueError, TypeError) as error:
        raise FlowError(f"{path}: cannot be read ({error})", ("gradient", "file")) from None
    return instants, in_rows(data, starts, count)


def _of_dimensions(data: Any) -> tuple[Any, list[str]]:
    """Instants and order of the axes of a dataset by the names of its dimensions, if it has any."""
    for place, dimension in enumerate(list(data.dims)[:2]):
        scales = [scale for name, scale in dimension.items() if scale.ndim == 1]
        names = [dimension.label, *(scale.name.rpartition("/")[2] for scale in scales)]
        if any(name in ("t", "time") for name in names):
            order = ["time", "trajectory"] if place == 0 else ["trajectory", "time"]
            return (scales[0] if scales else None), order
    return None, ["trajectory", "time"]


def series_of_case(spec: Mapping[str, Any], folder: Path) -> GradientSeries:
    """The series of the paths of a linear flow's specification; raises FlowError."""
    given = spec.get("gradient") if isinstance(spec, Mapping) else None
    if not isinstance(given, Mapping) or spec.get("type") != "linear":
        raise FlowError("has no paths; a linear flow with gradient: {file: ...} has", ("gradient",))
    check_keys({k: v for k, v in spec.items() if k != "type"}, ["gradient", "trajectory"], "linear")
    return series_of_file(resolve_paths(given, folder))
