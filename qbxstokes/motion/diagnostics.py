"""What is read off the axis of a body: orbit constant, phase, periods, drift.

The axis D3 is described by its components (a, b, n) along stream, gradient and vorticity of the
shear: the rows of `frame` (3, 3), the axes of space for the flow (x2, 0, 0). Jeffery (Proc. R. Soc.
A 102, 1922, eqs. 48-50): on a free orbit in shear C is constant and the phase falls by 2 pi in
every period T = 2 pi (k + 1/k)/rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def _components(axis: ArrayLike, frame: ArrayLike | None) -> tuple[Array, Array, Array]:
    d = np.asarray(axis, dtype=np.float64)
    if frame is not None:
        d = d @ np.asarray(frame, dtype=np.float64).T
    return d[..., 0], d[..., 1], d[..., 2]


def orbit_constant(
    axis: ArrayLike, aspect_ratio: float | Array, frame: ArrayLike | None = None
) -> Array:
    """C = sqrt(b^2 + k^2 a^2)/(k |n|), (..., 3) -> (...): 0 log-rolling, infinite tumbling."""
    a, b, n = _components(axis, frame)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.hypot(b, aspect_ratio * a) / (aspect_ratio * np.abs(n)))


def orbit_share(axis: ArrayLike, aspect_ratio: float, frame: ArrayLike | None = None) -> Array:
    """C/(1 + C), (..., 3) -> (...): the orbit constant between 0 (log-rolling) and 1 (tumbling)."""
    a, b, n = _components(axis, frame)
    turning = np.hypot(b, aspect_ratio * a)
    return np.asarray(turning / (turning + aspect_ratio * np.abs(n)))


def jeffery_phase(axis: ArrayLike, aspect_ratio: float, frame: ArrayLike | None = None) -> Array:
    """Phase atan2(b, k a), (..., 3) -> (...), linear in time on a Jeffery orbit; in (-pi, pi]."""
    a, b, _ = _components(axis, frame)
    return np.asarray(np.arctan2(b, aspect_ratio * a))


def orbit_axis(aspect_ratio: ArrayLike, constant: ArrayLike, phase: ArrayLike) -> Array:
    """Axis (..., 3) on the Jeffery orbit C in the shear (x2, 0, 0), any length but zero.

    (C cos p, -C k sin p, 1), and its limit (cos p, -k sin p, 0) for infinite C; the phase p of a
    massless body grows by 2 pi in a period (Jeffery 1922, eqs. 48 f.).
    """
    k, c, p = (np.asarray(value, dtype=float) for value in (aspect_ratio, constant, phase))
    # Both divided by 1 + C, so that tumbling needs no case of its own but the number itself.
    part = np.where(np.isinf(c), 1.0, c / (1.0 + np.where(np.isinf(c), 0.0, c)))
    return np.stack(np.broadcast_arrays(part * np.cos(p), -k * part * np.sin(p), 1.0 - part), -1)


def rotation_period(gradient: Array, aspect_ratio: float) -> float | None:
    """Period of a free spheroid's axis in a linear flow, None where it comes to rest.

    The axis follows the linear system dd/dt = (W + lambda E) d up to its length, with
    lambda = (1 - k^2)/(1 + k^2) (Bretherton 1962, J. Fluid Mech. 14, eq. 15 f.); a complex pair of
    eigenvalues +-i omega + sigma makes it turn with period 2 pi/omega. In a shear of rate 1 this
    is Jeffery's 2 pi (k + 1/k).
    """
    k = aspect_ratio
    shape = (1.0 - k * k) / (1.0 + k * k)
    largest = float(np.abs(gradient).max())
    if not largest > 0.0:
        return None
    gradient = gradient / largest  # so that no rate is too large or too small for its square
    strain, spin = 0.5 * (gradient + gradient.T), 0.5 * (gradient - gradient.T)
    if not np.any(spin):
        return None
    # omega^2 = -(1/2) tr (W + lambda E)^2 when the third eigenvalue vanishes, which is exact for
    # plane flows where thin bodies make the eigenvalue problem ill-conditioned.
    system = spin + shape * strain
    if abs(np.linalg.det(system)) <= 1e-14 * np.abs(system).max() ** 3:
        squared = 0.5 * float(np.sum(spin * spin) - shape**2 * np.sum(strain * strain))
        omega = math.sqrt(max(0.0, squared))
    else:
        omega = float(np.abs(np.linalg.eigvals(system).imag).max())
    return 2.0 * math.pi / omega / largest if omega > 0.0 else None


@dataclass(frozen=True)
class HalfTurns:
    """What the crossings of the axis through one plane say; a period is two half-turns.

    times (m,) of the crossings, orbit_constant (m,) at them; periods (m - 2,) from each crossing
    to the second next; mean_period over all of them, period_drift and orbit_drift the changes
    per period of period and ln C (least squares). NaN where there are too few crossings.
    """

    times: Array
    orbit_constant: Array
    periods: Array
    mean_period: float
    period_drift: float
    orbit_drift: float


def half_turns(
    times: ArrayLike, axes: ArrayLike, aspect_ratio: float, frame: ArrayLike | None = None
) -> HalfTurns:
    """Periods and drifts from crossing times (m,) and the axes (m, 3) there."""
    t = np.asarray(times, dtype=np.float64)
    constant = orbit_constant(
        np.asarray(axes, dtype=np.float64).reshape(-1, 3), aspect_ratio, frame
    )
    periods = t[2:] - t[:-2]
    whole = (len(t) - 1) // 2
    mean = float((t[2 * whole] - t[0]) / whole) if whole > 0 else float("nan")
    with np.errstate(divide="ignore"):
        logarithm = np.log(constant)
    return HalfTurns(
        times=t,
        orbit_constant=constant,
        periods=periods,
        mean_period=mean,
        period_drift=_slope(periods),
        orbit_drift=_slope(logarithm),
    )


def _slope(values: Array) -> float:
    """Change per period of values taken at every half-turn."""
    if len(values) < 2 or not np.all(np.isfinite(values)):
        return float("nan")
    index = np.arange(len(values)) - 0.5 * (len(values) - 1)
    return float(2.0 * (index @ values) / (index @ index))


def phase_period(times: ArrayLike, phase: ArrayLike) -> tuple[float, float]:
    """Period 2 pi/|slope| of a phase sampled at least twice a period, and its largest residual.

    times (T,), phase (T,) as `jeffery_phase` gives it. Least squares; the residual, in radians, is
    the deviation of the phase from uniform progress.
    """
    t = np.asarray(times, dtype=np.float64)
    angle = np.unwrap(np.asarray(phase, dtype=np.float64))
    centred = t - t.mean()
    slope = float(centred @ (angle - angle.mean()) / (centred @ centred))
    residual = float(np.max(np.abs(angle - angle.mean() - slope * centred)))
    return (2.0 * np.pi / abs(slope) if slope else float("inf")), residual
