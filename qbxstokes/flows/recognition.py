"""Functions that are polynomials of degree three or less: found out by trying, and checked on.

A fit about the origin of space, from values within the flow's own length, is held against the
function at points up to a hundred times as far, and at several instants where time is given.
Coefficients are rounded to the shortest decimals that the values do not tell apart from them, so
that what was written with few digits is found as it was written.
"""

import math
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import permutations
from typing import Any

import numpy as np

from qbxstokes.errors import FlowError, FlowFunctionError
from qbxstokes.flows.base import Flow
from qbxstokes.flows.changing import ChangingFlow
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.flows.signals import Part, Signal
from qbxstokes.typing import Array

# Derivative indices of the second and third degree, symmetric ones once, as the kernels take them.
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
TRIPLES = (
    *((0, 0, 0), (0, 0, 1), (0, 0, 2), (0, 1, 1), (0, 1, 2)),
    *((0, 2, 2), (1, 1, 1), (1, 1, 2), (1, 2, 2), (2, 2, 2)),
)
_INDICES: tuple[tuple[int, ...], ...] = ((), (0,), (1,), (2,), *PAIRS, *TRIPLES)
_COUNT = {0: 4, 1: 4, 2: 10, 3: 20}
# Points beyond those that a fit needs; of the check beside a body, the corners of a tetrahedron.
_MORE = 6
_CORNERS = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
# Differences from the polynomial over the sum of its terms' sizes: at first, and along a run.
_ALIKE, _STILL_ALIKE = 1e-12, 1e-11
_STOKESIAN = 1e-6
_NOISE = 16.0 * 2.0**-52
# Where and when it is tried, over the flow's length and in its unit of time.
_FAR, _INSTANTS = (1.0, 10.0, 100.0), (0.0, 0.013, 0.17, 0.61, 1.9, 7.3, 31.0)


_POWERS = np.array([[index.count(j) for j in range(3)] for index in _INDICES])
_FACTORIALS = np.array([math.prod(math.factorial(n) for n in row) for row in _POWERS.tolist()])


def monomials(points: Array) -> Array:
    """x^alpha/alpha! (n, 20): what derivatives at the origin are multiplied by."""
    powers = points[:, :, None] ** np.arange(4.0)
    parts = [powers[:, j, _POWERS[:, j]] for j in range(3)]
    return np.asarray(parts[0] * parts[1] * parts[2] / _FACTORIALS)


@dataclass(frozen=True)
class _Fit:
    """Derivatives from the values of a function at points, for polynomials of a degree.

    points (m, 3); solve (c, m); size: |solve|; misfit (m, m): what the fit leaves of the values.
    """

    points: Array
    solve: Array
    size: Array
    misfit: Array


@cache
def _fit(degree: int, length: float) -> _Fit:
    count = _COUNT[degree]
    rng = np.random.default_rng(degree)
    points = rng.normal(size=(count + _MORE, 3))
    points *= (2.0 * rng.uniform(0.3, 1.0, (len(points), 1))) / np.linalg.norm(
        points, axis=1, keepdims=True
    )
    points *= length
    values = monomials(points)[:, :count]
    scale = np.abs(values).max(axis=0)
    solve = np.linalg.pinv(values / scale) / scale[:, None]
    return _Fit(points, solve, np.abs(solve), np.eye(len(points)) - values @ solve)


class PolynomialInTime(ChangingFlow):
    """A function that is a polynomial of a degree at every instant: its derivatives at the origin.

    What it is asked for is fitted anew, with some values more than that takes, which tell whether
    it is a polynomial still.
    """

    def __init__(self, source: Flow, degree: int) -> None:
        self.source, self._asked = source, max(1, degree)
        self._fit = _fit(self._asked, source.length)
        shape = len(self._fit.solve), 3
        about = self.derivatives, shape, ("function",), False, source.breaks, source.spacing
        super().__init__(Signal([Part(*about)]), _units(shape[0]), None, source.spec())

    def derivatives(self, t: float) -> Array:
        """Derivatives at the origin (4, 10 or 20, 3); raises FlowFunctionError."""
        values, fit = self.source.velocity(self._fit.points, t), self._fit
        size = np.abs(values)
        off = np.abs(fit.misfit @ values).max()
        if not off <= _STILL_ALIKE * size.max():
            raise FlowFunctionError(_no_longer(self._asked, f"at t = {t:.6g}"), ("function",))
        found: Array = fit.solve @ values
        found[np.abs(found) <= _NOISE * (fit.size @ size)] = 0.0
        return found


@cache
def _units(count: int) -> list[PolynomialFlow]:
    """The flows of which one derivative at the origin is one, the others zero."""
    return [_polynomial(row.reshape(count, 3)) for row in np.eye(3 * count)]


@dataclass
class Recognition:
    """A function that was found to be a polynomial, and the flow in its place."""

    source: Flow
    flow: PolynomialFlow | PolynomialInTime
    derivatives: Array  # (c, 3) of a steady one

    @property
    def told(self) -> str:
        """What was found, in words."""
        times = " at every instant" if isinstance(self.flow, PolynomialInTime) else ""
        return f"a polynomial of degree {self.flow.degree}{times}, checked at every step"

    def check(self, t: float, x: Array, radius: float) -> None:
        """Hold it against the function around centres x (n, 3); raises FlowFunctionError."""
        points = (x[:, None] + 0.577 * radius * _CORNERS).reshape(-1, 3)
        derivatives = self.derivatives
        if isinstance(self.flow, PolynomialInTime):
            derivatives = self.flow.derivatives(t)
        off = _differences(derivatives, self.source, points, t)
        if not off.max() <= _STILL_ALIKE:
            place = ", ".join(f"{value:.6g}" for value in points[int(np.argmax(off))])
            where = f"at ({place}), t = {t:.6g}"
            raise FlowFunctionError(_no_longer(self.flow.degree or 0, where), ("function",))

    def require_stokesian(self, t: float, radius: float) -> None:
        """Raise FlowError where it is no Stokes flow, told by the derivatives of an instant."""
        if isinstance(self.flow, PolynomialInTime):
            _require_stokesian(self.flow.derivatives(t), radius)


def _require_stokesian(derivatives: Array, radius: float) -> None:
    full = _tensors(derivatives)
    size = sum(radius**n * np.abs(part).max() for n, part in enumerate(full[1:]))
    pull = np.einsum("ijkk->ij", full[3])
    traces = [np.abs(np.einsum("ii...->...", part)).max() for part in full[1:]]
    off = max(radius**n * trace for n, trace in enumerate(traces))
    twist = radius**2 * np.abs(pull - pull.T).max()
    if max(off, twist) > _STOKESIAN * size:
        what = "divergence" if off > twist else "curl of the Laplacian"
        raise FlowError(
            f"the flow is not Stokesian: the {what} of the velocity is "
            f"{max(off, twist) / size:.3g} (relative to the velocity gradient) and must vanish"
        )


def _no_longer(degree: int, where: str) -> str:
    return (
        f"the function is a polynomial of degree {degree} where it was tried first, but not "
        f"{where}; recognise: false takes it as it is"
    )


def _differences(derivatives: Array, source: Flow, points: Array, t: float) -> Array:
    """|u - p| over the size of the terms of p at points (n, 3); NaN where u has no value.

    derivatives (c, 3) of p at the origin.
    """
    terms = monomials(points)[:, : len(derivatives)]
    sizes = np.linalg.norm(np.abs(terms) @ np.abs(derivatives), axis=1)
    off = np.linalg.norm(source.velocity(points, t) - terms @ derivatives, axis=1)
    return np.asarray(off / (sizes + 1e-3 * sizes.max() + 1e-300))


def recognised(flow: Flow) -> Recognition | None:
    """What a function is recognised as; None where it is no polynomial, or not known to be one."""
    if len(flow.singular_points):
        return None
    with suppress(FlowError), np.errstate(all="ignore"):
        return _tried(flow)
    return None


def _tried(flow: Flow) -> Recognition | None:
    length = max(1.0, flow.length)
    fits = [_fit(3, length * share) for share in _FAR]
    far = np.concatenate([2.0 * length * share * _directions() for share in _FAR])
    degree, found = 0, np.zeros((20, 3))
    for t in (0.0,) if flow.steady else _INSTANTS:
        try:
            values = [flow.velocity(fit.points, t) for fit in fits]
        except FlowFunctionError:
            if t == 0.0:
                return None
            continue  # a function of a limited time
        for fit, each in zip(fits, values, strict=True):
            if not np.abs(fit.misfit @ each).max() <= _ALIKE * np.abs(each).max():
                return None
        found = _settled(fits, values)
        if not _differences(found, flow, far, t).max() <= _ALIKE:
            return None
        degree = max(degree, int(_POWERS[np.any(found, axis=1)].sum(axis=1).max(initial=0)))
    if not flow.steady:
        return Recognition(flow, PolynomialInTime(flow, degree), found)
    steady = _polynomial(found).stokesian()
    off = np.linalg.norm(steady.velocity(far) - monomials(far) @ found)
    return Recognition(flow, steady, found) if off <= _ALIKE * np.abs(values[-1]).max() else None


@cache
def _directions() -> Array:
    ways = np.random.default_rng(5).normal(size=(6, 3))
    return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))


def _settled(fits: list[_Fit], values: list[Array]) -> Array:
    """Derivatives (20, 3), each from the fit that knows it best.

    And of these the shortest decimal that the values' rounding leaves open.
    """
    pairs = list(zip(fits, values, strict=True))
    all_noise = np.array([_NOISE * (fit.size @ np.abs(each)) for fit, each in pairs])
    best = np.argmin(all_noise, axis=0)[None]
    noise = np.take_along_axis(all_noise, best, 0)[0]
    found = np.take_along_axis(np.array([fit.solve @ each for fit, each in pairs]), best, 0)[0]
    for place, value in np.ndenumerate(found):
        for digits in range(13):
            near = float(f"{value:.{digits}g}") if digits else 0.0
            if abs(near - value) <= noise[place]:
                found[place] = near
                break
    return np.asarray(found)


def _polynomial(derivatives: Array) -> PolynomialFlow:
    """The flow of derivatives (c, 3) at the origin."""
    return PolynomialFlow(*_tensors(derivatives))


def _tensors(derivatives: Array) -> list[Any]:
    """Velocity and its derivatives up to the third, symmetric, of (c, 3) at the origin."""
    tensors: list[Any] = [np.zeros((3,) * rank) for rank in (1, 2, 3, 4)]
    for index, row in zip(_INDICES, derivatives, strict=False):
        for places in _orders(index):
            tensors[len(index)][(slice(None), *places)] = row
    return tensors


@cache
def _orders(index: tuple[int, ...]) -> set[tuple[int, ...]]:
    return set(permutations(index))
