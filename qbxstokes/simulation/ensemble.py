"""Ensembles: bodies along many paths, of which statistics are kept and not the motions.

Paths are followed in blocks of fixed size, which follow from their numbers alone, and blocks are
added in their order: the numbers do not depend on who follows which. A block reads its gradients
once, in tiles of time, for all bodies.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.case.running import RATES, STRAINS, Brownian, Statistics
from qbxstokes.errors import ConvergenceError, SceneError
from qbxstokes.flows import Flow
from qbxstokes.flows.interpolation import INTERPOLATIONS
from qbxstokes.flows.series import GradientSeries
from qbxstokes.motion.random_turns import MOST_VARIANCE, Turns
from qbxstokes.simulation import arguments as given
from qbxstokes.simulation.body import Body
from qbxstokes.simulation.ensemble_means import (
    Found,
    Sums,
    added,
    mean_stresses,
    rates_with_flow,
    slenderness,
    standard_error,
    stress_columns,
)
from qbxstokes.simulation.rheology import particle_of
from qbxstokes.simulation.shared_gradient import SharedGradient, gradients_of
from qbxstokes.typing import Array, Integers

# Paths of a block, and instants of a tile of time.
BLOCK, TILE = 256, 1024
MOMENTS = 4
# Squares of rates in units of 2 <E:E> of the first block: decades that their bins cover.
_DECADES = -6.0, 3.0


@dataclass(frozen=True)
class Ensemble:
    """Bodies along all paths of a series, or in one gradient A(t), free of forces.

    axes: None, at random for each path, or (3,) or (paths, 3) at the start, where bodies with
    inertia turn with the flow. tolerance: error accepted of each axis at the end.
    """

    bodies: tuple[Body, ...]
    series: GradientSeries | SharedGradient
    axes: Array | None = None
    settings: Statistics = field(default_factory=lambda: Statistics.read({}))
    tolerance: float = 1e-6
    brownian: Brownian | None = None
    given_laws: Array | None = None  # see `laws`

    def __post_init__(self) -> None:
        """Raises SceneError for what cannot be followed."""
        for body in self.bodies:
            body.check_size()
            if np.ndim(body.stokes_number):
                right = "a number: bodies that differ are bodies of their own"
                raise SceneError("body.stokes_number", "is an array", right)
            if turns_with_inertia(body) and (self.settings.stresses or self.brownian):
                right = "0: stresses and Brownian turns along paths are those of massless bodies"
                raise SceneError("body.stokes_number", f"is {body.stokes_number:g}", right)
        if not self.bodies:
            raise SceneError("bodies", "are none", "one body at least")
        given.accepted(self.tolerance)
        if self.axes is not None and self.axes.shape not in ((3,), (self.paths, 3)):
            right = f"(3,), or ({self.paths}, 3), one for each path"
            raise SceneError("orientation", f"has shape {self.axes.shape}", right)
        if len(self.looks) < 1:
            raise SceneError("statistics", "leave no sample", "less discard")
        if self.brownian is not None:
            self._check_brownian(self.brownian)

    def _check_brownian(self, asked: Brownian) -> None:
        for name in ("translation", "step"):
            if name in asked.given_keys:
                right = "leave it out: axes turn from sample to sample of the series"
                raise SceneError(f"brownian.{name}", "has no meaning along paths", right)
        most = MOST_VARIANCE / (2.0 * float(np.diff(self.series.intervals[0]).max()))
        if asked.rotary_diffusivity > most:
            wrong = f"is {asked.rotary_diffusivity:g}"
            right = f"at most {most:.3g} for samples so far apart"
            raise SceneError("brownian.rotary_diffusivity", wrong, right)

    @property
    def paths(self) -> int:
        """Number of paths."""
        return len(self.series)

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return -(-self.paths // BLOCK)

    @cached_property
    def looks(self) -> Integers:
        """Samples at which something is looked at."""
        last = len(self.series.times) - 1
        return np.arange(int(np.ceil(self.settings.discard * last)), last, self.settings.every)

    @cached_property
    def lags(self) -> Integers:
        """Lags of the correlation, in looks: 0, and up to half of them in equal proportion."""
        longest = len(self.looks) // 2
        if not self.settings.correlation or longest < 1:
            return np.zeros(1, dtype=np.int64)
        steps = np.geomspace(1.0, longest, self.settings.correlation)
        return np.unique(np.concatenate([[0], np.round(steps)]).astype(np.int64))

    @property
    def names(self) -> tuple[str, ...]:
        """All that is found, in the order of the sums; axes of strain where they are asked for."""
        return (*RATES, *STRAINS) if {*STRAINS} & {*self.settings.quantities} else RATES

    @property
    def diffusivity(self) -> float:
        """Of the axes, 0 without Brownian motion."""
        return 0.0 if self.brownian is None else self.brownian.rotary_diffusivity

    @cached_property
    def laws(self) -> Array:
        """lambda, 1/2 - |lambda|/2, r, r', g (`inertial_paths`, or 0) and estimated errors, (B, 6).

        With stresses (B, 10): S0, S1, S2 and 3 kT lambda over the volume as well.
        """
        if self.given_laws is not None:
            return self.given_laws
        laws = []
        for body in self.bodies:
            inertial = turns_with_inertia(body)
            m = body.formed(1, "surface" if inertial else None)[0].model
            own = [m.faxen.linear, m.faxen.rest, 0.0, 0.0, 0.0, m.error_estimate]
            if inertial:
                across, _, along = m.shape.inertia.tolist()
                pulls = (
                    m.resistance.rotation_transverse / across,
                    m.resistance.rotation_axial / along,
                )
                own[2:5] = *np.array(pulls) / body.stokes_number, along / across
            if self.settings.stresses:
                p, error = particle_of(body)
                kt = self.diffusivity * p.resistance
                own[5] = max(own[5], error)
                own += [float(s) for s in (*p.stresslet, 3.0 * kt * p.linear) / np.array(p.volume)]
            laws.append(own)
        return np.array(laws)

    @property
    def bytes_of_sums(self) -> int:
        """Memory that the sums of a block take."""
        b, q = len(self.bodies), len(self.names)
        numbers = 2 * len(self.looks) + self.settings.bins + 3 * MOMENTS
        axes = 3 * b * len(self.looks) * min(self.settings.keep, self.paths)
        return 8 * (b * (q * numbers + 2 * len(self.lags)) + axes)

    def starts(self, first: int, stop: int) -> Array:
        """Axes (n, 3) at the start; those at random have a generator for each block."""
        if self.axes is not None:
            axes = np.broadcast_to(self.axes, (self.paths, 3))[first:stop]
        else:
            generator = np.random.default_rng([self.settings.seed, first // BLOCK])
            axes = generator.standard_normal((BLOCK, 3))[: stop - first]
        return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))

    @cached_property
    def rate(self) -> float:
        """sqrt(2 <E:E>) of gradients of the first block: the unit of bins."""
        a = self.series.typical(min(BLOCK, self.paths)).reshape(-1, 3, 3)
        strain = 0.5 * (a + np.swapaxes(a, 1, 2))
        return float(np.sqrt(2.0 * np.mean(np.sum(strain * strain, axis=(1, 2))))) or 1.0

    @property
    def floor(self) -> float:
        """log10 of the first edge of the bins of rates squared."""
        return 2.0 * float(np.log10(self.rate)) + _DECADES[0]

    def block(self, number: int) -> Sums:
        """What is found on the paths of a block."""
        return self.follow(number)[0]

    def follow(self, number: int, other: GradientSeries | None = None) -> tuple[Sums, Array]:
        """Sums over a block, and its axes at the end; of another series of the same paths."""
        from qbxstokes.motion import path_statistics
        from qbxstokes.motion.paths import follow_axes

        series = self.series if other is None else other
        first, stop = number * BLOCK, min((number + 1) * BLOCK, self.paths)
        n, b, q = stop - first, len(self.bodies), len(self.names)
        edges, windows, weights = series.intervals
        lengths, count = np.diff(edges), weights.shape[2]
        looks = self.looks if other is None else np.empty(0, dtype=np.int64)
        places = np.full(len(lengths), -1)
        places[np.searchsorted(edges, series.times[looks])] = np.arange(len(looks))
        tile = max(1, TILE * len(edges) // int(windows[-1] + count))
        lags = np.full(self.lags[-1] + 1, -1)
        lags[self.lags] = np.arange(len(self.lags))
        bins, (low, high) = self.settings.bins, _DECADES
        span = float(edges[-1] - edges[0])
        tolerances = self.tolerance / (slenderness(self.bodies) * span)
        axes = np.repeat(self.starts(first, stop)[:, None], b, axis=1)
        keep = min(n, self.settings.keep) if number == 0 and other is None else 0
        kept, instants = np.empty((keep, len(looks), b, 3)), np.empty((len(looks), b, q, 2))
        moments, rates = np.zeros((n, b, q, MOMENTS)), np.zeros((n, 2))
        counts = np.zeros((b, q, bins + 2), dtype=np.int64)
        origins, products = np.zeros((n, b, 3)), np.zeros((b, len(self.lags), 2))
        numbers = np.ascontiguousarray(self.laws[:, 6:]).reshape(-1, 4)
        stresses = np.zeros((n, b, 13 if len(numbers) else 0))
        diffusivity = self.diffusivity if other is None else 0.0
        seed = 0 if self.brownian is None else self.brownian.seed
        for begin in range(0, len(lengths), tile):
            part = slice(begin, min(begin + tile, len(lengths)))
            low_sample = int(windows[part][0])
            end_sample = int(windows[part][-1]) + count
            samples = series.read(first, stop, low_sample, end_sample)
            if begin == 0:
                spins = rates_with_flow(self.laws, samples[:, 0], axes)
            here = places[part]
            seen = np.zeros((len(here), b, q, 2))
            axes_seen = np.empty((keep, len(here), b, 3))
            follow_axes(
                samples,
                (
                    windows[part] - low_sample,
                    np.array(weights[part], order="C"),
                    lengths[part],
                    span,
                ),
                self.laws,
                tolerances,
                axes,
                spins,
                path_statistics.Wanted(here, q, self.floor, bins / (high - low), lags, numbers),
                path_statistics.Sums(moments, rates, counts, seen, origins, products, stresses),
                axes_seen,
                Turns(diffusivity, seed, first, begin),
            )
            if not np.isfinite(axes).all():
                lost = first + int(np.argwhere(~np.isfinite(axes))[0, 0])
                raise ConvergenceError(f"path {lost}: inertia, and too far a turn between samples")
            instants[here[here >= 0]] = seen[here >= 0]
            kept[:, here[here >= 0]] = axes_seen[:, here >= 0]
        looked = max(len(looks), 1)
        means, rates = moments / looked, rates / looked
        sums = {
            "paths": np.array([n]),
            "means": np.stack([means.sum(axis=0), (means**2).sum(axis=0)]),
            "rates": np.array([*rates.sum(axis=0), np.sum(rates[:, 0] ** 2)]),
            "with_strain": np.einsum("pbq,p->bq", means[..., 0], rates[:, 0]),
            "counts": counts,
            "instants": instants,
            "products": products,
        }
        if len(numbers):
            columns = stress_columns(stresses / looked, numbers[:, 3])
            sums["stresses"] = np.stack([columns.sum(axis=0), (columns**2).sum(axis=0)])
            sums["power_with_strain"] = np.einsum("pb,p->b", columns[..., -1], rates[:, 0])
        return (sums | {"axes": kept} if keep else sums), axes

    def sampling(self) -> dict[str, Any]:
        """What the spacing of the samples leaves of the axes at the end, by the first block.

        From the same run on every other sample, whose error is 2^order times as large; where the
        number of samples is even, up to the last but one of them. Of one A(t): what it says itself.
        """
        if isinstance(self.series, SharedGradient):
            return self.series.sampling()
        times = self.series.times
        odd = len(times) - (len(times) + 1) % 2
        order = INTERPOLATIONS[self.series.interpolation]
        n = min(BLOCK, self.paths)
        samples = self.series.read(0, n, 0, odd)
        whole = GradientSeries(times[:odd], samples, interpolation=self.series.interpolation)
        if len(whole.thinned().times) < max(2, order):
            return {}
        fine, coarse = (self.follow(0, one)[1] for one in (whole, whole.thinned()))
        off = np.linalg.norm(fine - coarse, axis=-1) / max(1.0, 2.0**order - 1.0)
        return {
            "axis_rms": float(np.sqrt(np.mean(off**2))),
            "axis_median": float(np.median(off)),
            "axis_90_percent": float(np.quantile(off, 0.9)),
            "paths": n,
        }

    def result(self, blocks: Iterable[Sums], sampling: Mapping[str, Any] | None = None) -> Found:
        """The statistics of all blocks, given in their order."""
        total: Sums = {}
        for sums in blocks:
            total = added(total, sums)
        paths = int(total["paths"][0])
        chosen = [self.names.index(name) for name in self.settings.quantities]
        first, square = total["means"][:, :, chosen] / paths
        strain, vorticity, strain_square = (total["rates"] / paths).tolist()
        mixed = total["with_strain"][:, chosen] / paths

        # Of the ratio to <E:E>: the variance of what a path differs from the ratio's line.
        ratio = first[..., 0] / (strain or np.nan)
        off = square[..., 0] - 2.0 * ratio * mixed + ratio**2 * strain_square
        looks, bins = len(self.looks), self.settings.bins
        seen = total["instants"][:, :, chosen] / paths
        variance = seen[..., 1] - seen[..., 0] ** 2
        spacing = np.linspace(0.0, 1.0, bins + 1)
        decades = self.floor + spacing * (_DECADES[1] - _DECADES[0])
        edges = [10.0**decades if self.names[i] in RATES[:2] else spacing for i in chosen]
        value, number = np.moveaxis(total["products"], -1, 0)
        lag_times = self.series.times[self.looks[self.lags]] - self.series.times[self.looks[0]]
        with np.errstate(invalid="ignore", divide="ignore"):
            correlation = value / number
        return Found(
            quantities=tuple(self.settings.quantities),
            moments=first,
            moments_error=standard_error(square - first**2, paths),
            over_strain=ratio,
            over_strain_error=standard_error(off, paths) / (strain or np.nan),
            edges=np.array(edges),
            counts=total["counts"][:, chosen],
            time=self.series.times[self.looks],
            mean_in_time=np.moveaxis(seen[..., 0], 0, -1),
            spread_in_time=np.moveaxis(np.sqrt(np.maximum(variance, 0.0)), 0, -1),
            lag=lag_times,
            correlation=correlation,
            axes=total.get("axes"),
            stresses=mean_stresses(total, paths, strain, strain_square),
            summary={
                "paths": paths,
                "looks": looks,
                "strain_squared": strain,
                "vorticity_squared": vorticity,
                "trace": self.series.trace,
                "tolerance": self.tolerance,
                "model_error_estimate": float(self.laws[:, 5].max()),
                "sampling": dict(sampling or {}),
            },
        )


def turns_with_inertia(body: Body) -> bool:
    """Whether its rotation has inertia."""
    return bool(np.any(body.stokes_number)) and body.inertia != "translation"


def ensemble(
    bodies: Body | Sequence[Body],
    flow: GradientSeries | Flow | Callable[[float], ArrayLike],
    times: ArrayLike | None = None,
    *,
    paths: int | None = None,
    orientation: ArrayLike | str = "isotropic",
    statistics: Mapping[str, Any] | None = None,
    brownian: Mapping[str, Any] | None = None,
    tolerance: float = 1e-6,
) -> Found:
    """Statistics of bodies along the paths of a series of velocity gradients, or in one gradient.

    bodies: one, or several that are independent of each other. flow: gradients along paths (paths,
    T, 3, 3), in memory or in a file (`qs.GradientSeries`), or one for all, a linear flow or a
    function A(t): axes are then looked at from each of `times` (T,) to the last, and `paths` start
    at random (1000). orientation: "isotropic", at random, or axes (3,) or (paths, 3) at time 0.
    statistics, brownian: keys of these sections of a case; Brownian axes turn at random half before
    and half after each interval of the series, which is of second order in it. tolerance: error
    accepted of each axis at the end, for the interpolant; summary["sampling"] says what the samples
    leave, or by how much a sampled A(t) is off. Memory does not grow with the number of paths.

    >>> import numpy as np, qbxstokes as qs
    >>> shear, times = qs.flow("shear"), np.linspace(0.0, 10.0, 101)
    >>> found = qs.ensemble(qs.Body(0.5), shear, times, orientation=[0, 0, 1])
    >>> found.mean("spinning")[0]  # log-rolling: half of the vorticity
    array([0.25])
    """
    several = tuple(bodies) if isinstance(bodies, Sequence) else (bodies,)
    axes = None
    if not isinstance(orientation, str):
        axes = given.turned(orientation)
    elif orientation != "isotropic":
        raise SceneError("orientation", f"is {orientation!r}", "isotropic, or axes (..., 3)")
    settings = given.section("statistics", Statistics, statistics)
    random = None if brownian is None else given.section("brownian", Brownian, brownian)
    tolerance = given.accepted(tolerance)
    accuracy = tolerance / slenderness(several).max(initial=1.0)
    series = gradients_of(flow, times, paths, axes, accuracy)
    found = Ensemble(several, series, axes, settings, tolerance, random)
    sampling = found.sampling() if settings.sampling else {}
    return found.result((found.block(number) for number in range(found.blocks)), sampling)
