"""Velocity gradients along paths, from samples: in memory, in files, or made at random."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.errors import FlowError, FlowFunctionError
from qbxstokes.flows.interpolation import INTERPOLATIONS, power_weights
from qbxstokes.flows.random_gradients import RandomSamples
from qbxstokes.flows.samples import InFile, InRows, View
from qbxstokes.flows.user import resolve_paths
from qbxstokes.flows.values import SINGLE, Array, check_keys, number, whole
from qbxstokes.tables import HDF5, TableError, check_file, read_table

OUTSIDE = "error", "clamp", "repeat"
TRACES = "project", "error"


class GradientSeries:
    """Velocity gradients A(t) from samples: times (T,), gradients (..., T, 3, 3) or (..., T, 9).

    Leading axes are paths, each with gradients of its own at the same times. The nine components
    are by rows, du1/dx1 du1/dx2 ...; eight leave out the last, which follows from div u = 0.
    Samples keep their type (float32 is not copied); only their last axes are looked at here.

    interpolation: "sextic", the polynomial through the six samples around an instant (its error
    goes as spacing^6), "linear" or "hold" (the sample before it). trace: "project" takes a third of
    the trace off the diagonal and `trace` tells its largest size relative to |A|; "error" refuses.
    outside: "error" beyond the samples, "clamp" or "repeat" (the period is that of the samples).
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
        t = np.asarray(times, dtype=np.float64)
        a = gradients if hasattr(gradients, "shape") else np.asarray(gradients, dtype=np.float64)
        for name, value, known in (
            ("interpolation", interpolation, INTERPOLATIONS),
            ("trace", trace, TRACES),
            ("outside", outside, OUTSIDE),
        ):
            if value not in known:
                raise FlowError(f"{name} is one of {', '.join(known)}, not {value!r}", (name,))
        if isinstance(a, np.ndarray) and a.shape[-2:] == (3, 3):
            a = a.reshape(*a.shape[:-2], 9)
        if t.ndim != 1 or len(t) < 2 or np.any(np.diff(t) <= 0.0) or not np.isfinite(t).all():
            raise FlowError("times of a series must be two or more finite, increasing instants")
        if a.ndim < 2 or a.shape[-1] not in (8, 9) or a.shape[-2] != len(t):
            right = f"(..., {len(t)}, 3, 3), (..., {len(t)}, 9) or (..., {len(t)}, 8)"
            raise FlowError(f"gradients have shape {a.shape}; {right} is expected", ("gradient",))
        if interpolation == "sextic" and len(t) < 6:
            raise FlowError(
                f"{len(t)} samples are too few for six points; interpolation: linear", ("gradient",)
            )
        self.times, self.samples = t, a
        self.interpolation, self.trace_rule, self.outside = interpolation, trace, outside
        self.trace = 0.0

    @classmethod
    def from_file(cls, file: str | Path, **keys: Any) -> GradientSeries:
        """Of an HDF5, netCDF-4, NPY or CSV file, by the keys of `series_of_file`."""
        return series_of_file({"file": str(file), **keys})

    @property
    def paths(self) -> tuple[int, ...]:
        """Shape of the leading axes."""
        return tuple(self.samples.shape[:-2])

    @property
    def spacing(self) -> float:
        """Least time between samples."""
        return float(np.diff(self.times).min())

    def __len__(self) -> int:
        return math.prod(self.paths)

    @classmethod
    def gaussian(cls, **keys: Any) -> GradientSeries:
        """Paths at random (`random_gradients`): end, spacing, paths, rate, correlation_time, ..."""
        return series_of_file({"process": "gaussian", **keys})

    def path(self, number: int) -> GradientSeries:
        """The series of one path, by its number in the order of the leading axes."""
        if not 0 <= number < len(self):
            raise FlowError(f"trajectory {number} of {len(self)}", ("trajectory",))
        return self._with(self.times, self._rows[number, slice(None)])

    def chosen(self, numbers: NDArray[np.int64]) -> GradientSeries:
        """Some of the paths, by their numbers, in their order."""
        if np.array_equal(numbers, np.arange(len(self))):
            return self
        return self._with(self.times, View(self._rows, numbers, (0, len(self.times))))

    def thinned(self) -> GradientSeries:
        """The same of every other sample."""
        return self._with(self.times[::2], self._rows[:, ::2])

    def part(self, paths: slice, instants: slice) -> GradientSeries:
        """Some of the paths, by their numbers, at some of the instants; nothing is read."""
        first, last, _ = instants.indices(len(self.times))
        numbers = None if paths == slice(None) else np.arange(*paths.indices(len(self)))
        return self._with(self.times[first:last], View(self._rows, numbers, (first, last)))

    @property
    def _rows(self) -> Any:
        """Samples by path and instant, of which parts may be read."""
        whole = self.samples
        return whole.reshape(-1, *whole.shape[-2:]) if isinstance(whole, np.ndarray) else whole

    def _with(self, times: Array, samples: Any) -> GradientSeries:
        rules = {"interpolation": self.interpolation, "trace": self.trace_rule}
        return GradientSeries(times, samples, outside=self.outside, **rules)

    def read(self, first: int, stop: int, begin: int = 0, end: int | None = None) -> Array:
        """Samples begin to end (stop - first, T, 9) of some paths, traceless.

        Raises FlowError for what is no number.
        """
        a = np.array(self._rows[first:stop, begin:end], dtype=np.float64)
        if a.shape[-1] == 8:
            a = np.concatenate([a, -(a[..., :1] + a[..., 4:5])], axis=-1)
        size, least = float(np.max(a, initial=0.0)), float(np.min(a, initial=0.0))
        if not (math.isfinite(size) and math.isfinite(least)):
            path, sample, _ = np.argwhere(~np.isfinite(a))[0]
            where = f"path {first + path}, sample {begin + sample}"
            raise FlowError(f"{where} of the series is not finite")
        size = max(size, -least)
        third = (a[..., 0] + a[..., 4] + a[..., 8]) / 3.0
        self.trace = max(self.trace, 3.0 * float(np.abs(third).max()) / size if size else 0.0)
        if self.trace_rule == "error" and self.trace > SINGLE:
            raise FlowError(f"the gradients have a trace, {self.trace:.3g} of their size")
        for i in (0, 4, 8):
            a[..., i] -= third
        return a

    def inside(self, t: float) -> float:
        """The instant of the samples that stands for t; raises FlowError beyond them."""
        first, last = float(self.times[0]), float(self.times[-1])
        if first <= t <= last:
            return t
        if self.outside == "clamp":
            return min(max(t, first), last)
        if self.outside == "repeat":
            return first + (t - first) % (last - first)
        raise FlowFunctionError(
            f"t = {t:.6g} is outside the series, which covers {first:g} to {last:g}; "
            "outside: clamp or repeat goes on",
            ("outside",),
        )

    def breaks(self, end: float) -> Array:
        """The samples between 0 and `end`: between them the interpolant is a polynomial."""
        first, last = float(self.times[0]), float(self.times[-1])
        found = self.times
        if self.outside == "repeat":
            turns = np.arange(math.floor(-first / (last - first)), math.ceil(end / (last - first)))
            found = np.unique(turns[:, None] * (last - first) + self.times[:-1])
        return found[(found > 0.0) & (found < end)]

    def at(self, t: Array) -> Array:
        """A at instants (...) within the samples, (..., 3, 3), of a series of one path."""
        samples, count = self.read(0, 1)[0], INTERPOLATIONS[self.interpolation]
        flat = np.array([self.inside(s) for s in t.ravel().tolist()])
        places = np.clip(np.searchsorted(self.times, flat, "right") - 1, 0, len(self.times) - 2)
        first, weights = power_weights(self.times, self.interpolation)
        s = (flat - self.times[places]) / np.diff(self.times)[places]
        shares = np.einsum("nk,nkj->nj", s[:, None] ** np.arange(count), weights[places])
        window = samples[first[places][:, None] + np.arange(count)]
        found: Array = np.einsum("nj,njc->nc", shares, window)
        return found.reshape(*t.shape, 3, 3)

    def function(self) -> Callable[[float], Array]:
        """A(t) as a function, of a series of one path."""
        if len(self) != 1:
            raise FlowError(f"a series of {len(self)} paths; name a trajectory", ("trajectory",))
        samples = self.read(0, 1)[0]
        count, last = INTERPOLATIONS[self.interpolation], len(self.times) - 2
        first, weights = power_weights(self.times, self.interpolation)
        times, degrees = self.times.tolist(), np.arange(count)
        known: tuple[int, Array] = (-1, samples[:count])  # the interval of the last instant

        def gradient(t: float) -> Array:
            nonlocal known
            at = self.inside(t)
            interval = min(bisect_right(times, at) - 1, last)
            if known[0] != interval:
                begin = first[interval]
                known = interval, weights[interval] @ samples[begin : begin + count]
            if count == 1 and at >= times[-1]:
                return np.asarray(samples[-1].reshape(3, 3))
            s = (at - times[interval]) / (times[interval + 1] - times[interval])
            return np.asarray((s**degrees @ known[1]).reshape(3, 3))

        return gradient


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
    at random (`random_gradients`). Raises FlowError.
    """
    if "process" in given:
        return _of_process(given)
    known = ["file", "dataset", "time", "layout", "rows", "unit"]
    known += ["interpolation", "trace", "outside"]
    check_keys(given, known, "linear")
    rules = {name: given[name] for name in known[6:] if name in given}
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
    samples = RandomSamples(times, paths, rate, time, seed)
    return GradientSeries(times, samples)


def _of_hdf5(path: Path, given: Mapping[str, Any]) -> tuple[Array, Any]:
    import h5py

    try:
        data = h5py.File(path, "r")[given.get("dataset", "A")]
        scale, order = _of_dimensions(data)
        times = scale if scale and "time" not in given else data.file[given.get("time", "t")]
        times = np.asarray(times[:], dtype=np.float64)
    except (OSError, KeyError) as error:
        raise FlowError(f"{path}: cannot be read ({error})", ("gradient", "file")) from None
    return times, _laid_out(data, given, order)


def _of_npy(path: Path, given: Mapping[str, Any]) -> tuple[Array, Any]:
    try:
        data = np.load(path, mmap_mode="r", allow_pickle=False)
        times = np.load(path.parent / str(given["time"]), allow_pickle=False).astype(np.float64)
    except (OSError, ValueError, TypeError) as error:
        raise FlowError(f"{path}: cannot be read ({error})", ("gradient", "file")) from None
    return times, _laid_out(data, given, ["trajectory", "time"])


def _laid_out(data: Any, given: Mapping[str, Any], order: list[str]) -> InFile:
    """Samples of which the file tells the order of axes, or else the case."""
    layout = list(given.get("layout", order))
    if sorted(layout) != ["time", "trajectory"]:
        right = "[trajectory, time] or [time, trajectory]"
        raise FlowError(f"layout is {layout}; {right} is expected", ("gradient", "layout"))
    if data.ndim == 2 or (data.ndim == 3 and data.shape[1:] == (3, 3)):
        return InFile(data[...].reshape(1, len(data), -1), False)
    if data.ndim not in (3, 4):
        wrong = f"samples have shape {data.shape}; paths, instants and components are expected"
        raise FlowError(wrong, ("gradient", "file"))
    return InFile(data, layout[0] == "time")


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
    return instants, InRows(data, starts, count)


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
