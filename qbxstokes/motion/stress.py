"""What the particles add to the stress of a suspension, from the states of a motion.

The stresslet of a body free of torque in a polynomial flow needs the strain rate's mean over its
volume alone, <e>_V = (1 + (a_j^2 d_j^2)/10) e for a spheroid in a flow of degree <= 3 (Faxen's law:
S. Kim & S. J. Karrila 1991, Microhydrodynamics, section 3.3), and the three numbers of
`bie.stresslet`. Everything is in the space frame; p is the axis of symmetry, arrays are (n, ...).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from qbxstokes.flows.polynomial import PolynomialFlow

Array = NDArray[np.float64]
_UNIT: Array = np.eye(3)


def mean_strain(flow: PolynomialFlow, x: Array, p: Array, k: float | Array) -> Array:
    """Strain rate's mean (n, 3, 3) over spheroids (k, k, 1) at x (n, 3) with axes p (n, 3)."""
    gradient, second = flow.gradient(x), flow.third
    if flow.degree == 3:
        square = np.reshape(np.asarray(k) ** 2, (-1, 1, 1))
        laplacian = np.einsum("ijkk->ij", second)
        twice = np.einsum("nkl,ijkl->nij", p[:, :, None] * p[:, None, :], second)
        gradient = gradient + 0.1 * (square * laplacian + (1.0 - square) * twice)
    return np.asarray(0.5 * (gradient + gradient.swapaxes(-1, -2)))


def stresslets(numbers: Array, p: Array, strain: Array) -> Array:
    """S (n, 3, 3) free of torque: `bie.stresslet`'s law of S0, S1, S2 in the strain (n, 3, 3).

    numbers: (3,) or (3, n). Sorted by what is turned, the law is (p.E.p) (a pp + b I)
    + (S1 - S2) (p Ep + Ep p) + S2 E, with a = 3/2 S0 - 2 S1 + S2/2 and b = (S2 - S0)/2.
    """
    s0, s1, s2 = numbers
    stretched = np.matmul(strain, p[:, :, None])[:, :, 0]
    along = np.einsum("ni,ni->n", stretched, p)
    # p v + v p with v = (S1 - S2) E p + (a/2) (p.E.p) p holds the first two terms.
    v = _column(s1 - s2) * stretched + _column((0.75 * s0 - s1 + 0.25 * s2) * along) * p
    outer = p[:, :, None] * v[:, None, :]
    found = outer + outer.swapaxes(1, 2)
    found += np.asarray(s2)[..., None, None] * strain
    found += (0.5 * (s2 - s0) * along)[:, None, None] * _UNIT
    return np.asarray(found)


def torque_stresslets(law: float | Array, p: Array, torque: Array) -> Array:
    """(lambda/2) [p (T x p) + (T x p) p], (n, 3, 3): a hydrodynamic torque's T (n, 3) own part."""
    across = 0.5 * _column(law) * np.cross(torque, p)
    outer = p[:, :, None] * across[:, None, :]
    return np.asarray(outer + outer.swapaxes(1, 2))


def _column(values: float | Array) -> Array:
    return np.reshape(np.asarray(values), (-1, 1))
