"""What is found of bodies along many paths: rates at first, means over paths and time at last."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from qbxstokes.geometry.symmetric import components, symmetric
from qbxstokes.simulation.body import Body
from qbxstokes.simulation.result import shown
from qbxstokes.typing import AnyArray, Array, Integers

Sums = dict[str, AnyArray]

# Tensors that the statistics of stresses tell, in the order of their columns.
STRESSES = "particle_stress", "hydrodynamic_stress", "brownian_stress", "order_tensor"


@dataclass(frozen=True, repr=False)
class Found:
    """Statistics of B bodies, of Q quantities.

    moments, moments_error (B, Q, 4): means of powers 1 to 4 over paths and time, and their standard
    errors, paths being independent. over_strain, over_strain_error (B, Q): the means over <E:E>,
    which is epsilon/(2 nu), and their errors. edges (Q, bins + 1), counts (B, Q, bins + 2): below,
    in and beyond the bins. time (T,), mean_in_time, spread_in_time (B, Q, T): over paths. lag (L,),
    correlation (B, L): <p(t).p(t + lag)>. axes (kept paths, T, B, 3). stresses: means and standard
    errors of particle_stress (B, 3, 3), in mu over the unit of time and per volume fraction, of its
    hydrodynamic_stress and brownian_stress, of order_tensor <pp>, and of intrinsic_viscosity (B,),
    <Sigma:E>/(2 <E:E>); None where they were not asked for. summary: numbers of paths and
    looks, <E:E>, squared vorticity, the trace that was projected out, what the sampling leaves.
    """

    quantities: tuple[str, ...]
    moments: Array
    moments_error: Array
    over_strain: Array
    over_strain_error: Array
    edges: Array
    counts: Integers
    time: Array
    mean_in_time: Array
    spread_in_time: Array
    lag: Array
    correlation: Array
    axes: Array | None
    stresses: dict[str, tuple[Array, Array]] | None
    summary: dict[str, Any]

    def __repr__(self) -> str:
        held = {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        named = {name: mean for name, (mean, _) in (self.stresses or {}).items()}
        heading = f"Ensemble: {len(self.moments)} bodies; {', '.join(self.quantities)}"
        return shown(heading, held | {f"stresses: {n}": v for n, v in named.items()}, self.summary)

    def mean(self, quantity: str) -> tuple[Array, Array]:
        """Mean of a quantity, and its standard error, each (B,)."""
        place = self.quantities.index(quantity)
        return self.moments[:, place, 0], self.moments_error[:, place, 0]

    def variance(self, quantity: str) -> Array:
        """Variance of a quantity over paths and time, (B,)."""
        first, second = self.moments[:, self.quantities.index(quantity), :2].T
        return np.asarray(second - first**2)

    def over_dissipation(self, quantity: str = "tumbling") -> tuple[Array, Array]:
        """Mean of a squared rate times nu/epsilon = 1/(2 <E:E>), and its error, each (B,)."""
        place = self.quantities.index(quantity)
        return 0.5 * self.over_strain[:, place], 0.5 * self.over_strain_error[:, place]

    def density(self, quantity: str) -> tuple[Array, Array]:
        """Edges of bins (n + 1,) and probability densities in them (B, n)."""
        place = self.quantities.index(quantity)
        counts, edges = self.counts[:, place], self.edges[place]
        share = counts[:, 1:-1] / counts.sum(axis=-1, keepdims=True)
        return edges, share / np.diff(edges)


def rates_with_flow(laws: Array, gradients: Array, axes: Array) -> Array:
    """Rates dp/dt and spins about p of axes (n, B, 3) that turn with gradients (n, 9), (n, B, 4).

    laws (B, ...): lambda and 1/2 - |lambda|/2, by Jeffery's equation.
    """
    a = gradients.reshape(-1, 1, 3, 3)
    linear, rest = laws[:, 0, None, None], laws[:, 1, None, None]
    back = np.swapaxes(a, 2, 3)
    turning = rest * (a - back) + linear * np.where(linear < 0.0, back, a)
    rates = (turning @ axes[..., None])[..., 0]
    rates -= np.sum(rates * axes, axis=-1, keepdims=True) * axes
    curl = np.stack([a[..., i, j] - a[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1)
    return np.concatenate([rates, 0.5 * np.sum(curl * axes, axis=-1, keepdims=True)], axis=-1)


def slenderness(bodies: Sequence[Body]) -> Array:
    """k or 1/k of each body, (B,): by so much errors of what turns it may grow."""
    ratios = np.array([body.effective_ratio for body in bodies])
    return np.maximum(ratios, 1.0 / ratios)


def added(total: Sums, more: Sums) -> Sums:
    """Sums and those of further paths."""
    kept = {**total, **more}
    return kept | {name: total[name] + more[name] for name in total.keys() & more.keys()}


def standard_error(variance: Array, paths: int) -> Array:
    """Of means over independent paths."""
    return np.sqrt(np.maximum(variance, 0.0) / (paths - 1 if paths > 1 else np.nan))


def stress_columns(means: Array, brownian: Array) -> Array:
    """Of means (n, B, 13) on each path: the tensors of `STRESSES` and the power, (n, B, 25)."""
    flowing, order = means[..., :6], means[..., 6:12]
    thermal = brownian[:, None] * (order - components(np.eye(3)) / 3.0)
    return np.concatenate([flowing + thermal, flowing, thermal, order, means[..., 12:]], axis=-1)


def mean_stresses(
    total: Mapping[str, Any], paths: int, strain: float, strain_square: float
) -> dict[str, tuple[Array, Array]] | None:
    """What `Found.stresses` is, from sums over paths; strain, strain_square: <E:E>, <(E:E)^2>."""
    if "stresses" not in total:
        return None
    mean, square = total["stresses"] / paths
    error = standard_error(square - mean**2, paths)
    found = {
        name: (symmetric(mean[:, 6 * n : 6 * n + 6]), symmetric(error[:, 6 * n : 6 * n + 6]))
        for n, name in enumerate(STRESSES)
    }
    if strain:
        # The variance of what the power of a path differs from the ratio's line.
        ratio = mean[:, -1] / strain
        off = square[:, -1] - 2.0 * ratio * total["power_with_strain"] / paths
        off = standard_error(off + ratio**2 * strain_square, paths) / strain
        found["intrinsic_viscosity"] = 0.5 * ratio, 0.5 * off
    return found
