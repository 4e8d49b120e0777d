"""What the particles add to the stress of a suspension, from the states of a motion.

The stresslet of a body free of torque in a polynomial flow needs the strain rate's mean over its
volume alone, <e>_V = (1 + (a_j^2 d_j^2)/10) e for a spheroid in a flow of degree <= 3 (Faxen's law:
S. Kim & S. J. Karrila 1991, Microhydrodynamics, section 3.3), and the three numbers of
`bie.stresslet`. Everything is in the space frame; p is the axis of symmetry, arrays are (n, ...).
"""

from typing import Protocol

import numpy as np

from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.symmetric import PAIRS, components
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.layout import ORIENTATION, SPIN
from qbxstokes.typing import Array

_UNIT: Array = np.eye(3)


class StressSource(Protocol):
    """What knows the stresslets of the lanes of a scene, and the flow's gradient there.

    thermal: 3 kT lambda (n,) of the lanes, None without Brownian motion.
    """

    @property
    def thermal(self) -> Array | None:
        """As above."""

    def stresslet(self, t: float, x: Array, q: Array, p: Array, torque: Array | None) -> Array:
        """S (n, 6) in space, positions x (n, 3), unit quaternions q (n, 4) and axes p (n, 3).

        torque: hydrodynamic, (n, 3), None where there is none.
        """

    def gradient(self, t: float, states: Array) -> Array:
        """Velocity gradient (n, 3, 3) of the background flow at the centres."""


def mean_strain(flow: PolynomialFlow, x: Array, p: Array, k: float) -> Array:
    """Strain rate's mean over the volume of spheroids (k, k, 1) at x (n, 3) with axes p (n, 3).

    Rows (6, n) or (6, 1) of its components 11 22 33 12 13 23.
    """
    gradient = flow.gradient(x) if flow.degree > 1 else flow.gradient_tensor[None]
    if flow.degree == 3:
        square = k * k
        laplacian = np.einsum("ijkk->ij", flow.third)
        twice = np.einsum("nkl,ijkl->nij", p[:, :, None] * p[:, None, :], flow.third)
        gradient = gradient + 0.1 * (square * laplacian + (1.0 - square) * twice)
    return np.stack([0.5 * (gradient[:, i, j] + gradient[:, j, i]) for i, j in PAIRS])


def stresslets(numbers: Array, p: Array, strain: Array) -> Array:
    """S free of torque, rows (6, n): `bie.stresslet`'s law of S0, S1, S2 (3,) in the strain's rows.

    Sorted by what is turned, the law is (p.E.p) (a pp + b I) + (S1 - S2) (p Ep + Ep p) + S2 E,
    with a = 3/2 S0 - 2 S1 + S2/2 and b = (S2 - S0)/2.
    """
    s0, s1, s2 = numbers.tolist()
    p1, p2, p3 = (np.ascontiguousarray(row) for row in p.T)
    e11, e22, e33, e12, e13, e23 = strain
    v1 = e11 * p1 + e12 * p2 + e13 * p3
    v2 = e12 * p1 + e22 * p2 + e23 * p3
    v3 = e13 * p1 + e23 * p2 + e33 * p3
    along = v1 * p1 + v2 * p2 + v3 * p3
    # p v + v p with v = (S1 - S2) E p + (a/2) (p.E.p) p holds the first two terms.
    axial = (0.75 * s0 - s1 + 0.25 * s2) * along
    v1, v2, v3 = (
        (s1 - s2) * v1 + axial * p1,
        (s1 - s2) * v2 + axial * p2,
        (s1 - s2) * v3 + axial * p3,
    )
    even = 0.5 * (s2 - s0) * along
    found = np.empty((6, len(p)))
    found[0] = 2.0 * p1 * v1 + even + s2 * e11
    found[1] = 2.0 * p2 * v2 + even + s2 * e22
    found[2] = 2.0 * p3 * v3 + even + s2 * e33
    found[3] = p1 * v2 + p2 * v1 + s2 * e12
    found[4] = p1 * v3 + p3 * v1 + s2 * e13
    found[5] = p2 * v3 + p3 * v2 + s2 * e23
    return found


def torque_stresslets(law: float | Array, p: Array, torque: Array) -> Array:
    """(lambda/2) [p (T x p) + (T x p) p], (n, 6): a hydrodynamic torque's T (n, 3) own part."""
    across = 0.5 * _column(law) * np.cross(torque, p)
    outer = p[:, :, None] * across[:, None, :]
    return components(outer + outer.swapaxes(1, 2))


def inertial_stresses(
    equations: RigidBodyEquations, t: float, states: Array, gradient: Array
) -> tuple[Array, Array]:
    """Stresses times volume, (n, 3, 3), of bodies with mass: -sym(W M) and -G M G^T.

    W = [Omega']x + [Omega]x [Omega]x, G = [Omega]x - A and M = St int x x dV about the centre:
    acceleration, and motion past the flow (G. K. Batchelor 1970, J. Fluid Mech. 41, 545).
    """
    if equations.massless or equations.inertia == "translation":
        nothing = np.zeros((len(states), 3, 3))
        return nothing, nothing
    q = rotation.normalize(states[:, ORIENTATION])
    turn = rotation.matrix(q)
    rates = np.empty_like(states.T)
    equations.rates(t, np.ascontiguousarray(states.T), rates)
    _, omega = equations.velocities(t, states)
    # d(R w)/dt = R dw/dt of the angular velocity w in the body.
    change = np.einsum("nij,nj->ni", turn, rates[SPIN].T)
    # Moments of inertia J1, J3 give int x_3^2 = J1 - J3/2 and int x_1^2 = J3/2.
    across, along = equations.bodies.inertia[2], equations.bodies.inertia[3]
    inside = np.zeros((len(states), 3))
    inside[:, :2] = 0.5 * _column(along)
    inside[:, 2] = across - 0.5 * along
    moment = np.einsum("nij,nj,nkj->nik", turn, inside * _column(equations.stokes_number), turn)
    spin = _cross(omega)
    acceleration = (_cross(change) + spin @ spin) @ moment
    slip = spin - gradient
    return (
        -0.5 * (acceleration + acceleration.swapaxes(1, 2)),
        -(slip @ moment @ slip.swapaxes(1, 2)),
    )


def _cross(vectors: Array) -> Array:
    """Matrices (n, 3, 3) of the products v x."""
    return np.asarray(np.cross(vectors[:, None, :], _UNIT).swapaxes(1, 2))


def _column(values: float | Array) -> Array:
    return np.reshape(np.asarray(values), (-1, 1))
