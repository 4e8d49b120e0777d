"""The flow around a spheroid that moves or strains with its surface, u = V + A x there, exactly.

A layer h S n on the surface (h n dS-weight, S a constant matrix) is by the divergence theorem a
volume of Stokes dipoles, whose potentials are those of the homogeneous ellipsoid (T. Mura 1987,
Micromechanics of Defects in Solids, section 11; G. B. Jeffery 1922):

    u_i = -(1/8 pi) S_jk d_k (2 delta_ij Phi - d_i d_j Psi),   p = (1/4 pi) S_jk d_j d_k Phi,

Phi = int dV / r, Psi = int r dV. S follows from A on the surface. Derivatives of u and p are taken
by complex steps, and integrals over the confocal family by Gauss's rule where they are smooth.
"""

from __future__ import annotations

import numpy as np
from scipy.special import elliprd, elliprf

from qbxstokes.geometry.spheroid import Spheroid

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(80)
STEP = 1e-40


def _integral(k, lam, powers, a_i=None, a_j=None):
    """pi k^2 int_lam^inf s^powers / ((a_i + s)(a_j + s) Delta) ds, (N,)."""
    e2, pole, equator = (1.0 - k) * (1.0 + k), 1.0 + lam, k * k + lam
    # The smaller square over tau^2 as variable, and tau = sinh v / sqrt(m).
    small = equator if e2 > 0.0 else pole
    m = abs(e2) / small
    top = np.arcsinh(np.sqrt(m))
    v = 0.5 * top[:, None] * (_NODES + 1.0)
    tau = np.sinh(v) / np.sqrt(m)[:, None]
    s = small[:, None] / tau**2 - (k * k if e2 > 0.0 else 1.0)
    ds = 2.0 * small[:, None] / tau**3 * np.cosh(v) / np.sqrt(m)[:, None]
    value = s**powers / ((k * k + s) * np.sqrt(1.0 + s))
    for square in (a_i, a_j):
        if square is not None:
            value = value / (square + s)
    return np.pi * k * k * 0.5 * top * ((value * ds) @ _WEIGHTS)


def _dipoles(k, x):
    """u (9, N, 3) and p (9, N) of the nine unit matrices S."""
    squares = np.array([k * k, k * k, 1.0])
    rho2, z2 = x[:, 0] ** 2 + x[:, 1] ** 2, x[:, 2] ** 2
    half = 0.5 * (rho2 + z2 - k * k - 1.0)
    lam = half + np.sqrt(half * half + rho2 + k * k * z2 - k * k)
    delta = (k * k + lam) * np.sqrt(1.0 + lam)
    mass = np.pi * k * k
    scaled = x / (squares + lam[:, None])
    rise = 2.0 * scaled / np.sum(scaled**2, axis=1)[:, None]  # grad lambda
    i_k = np.stack([_integral(k, lam, 0, a) for a in squares], axis=1)
    w_ij = [[_integral(k, lam, 1, a, b) for b in squares] for a in squares]
    at = [[mass * lam / ((a + lam) * (b + lam) * delta) for b in squares] for a in squares]
    u = np.zeros((9, len(x), 3), dtype=x.dtype)
    p = np.zeros((9, len(x)), dtype=x.dtype)
    for number, (j, k_) in enumerate(np.ndindex(3, 3)):
        # S_jk = 1: u_i = -(2 delta_ij d_k Phi - d_k d_j (x_i W_i)) / 8 pi.
        u[number, :, j] += -4.0 * x[:, k_] * i_k[:, k_]
        for i in range(3):
            u[number, :, i] -= 2.0 * x[:, i] * x[:, j] * rise[:, k_] * at[i][j]
            if i == j:
                u[number, :, i] += 2.0 * x[:, k_] * w_ij[i][k_]
            if i == k_:
                u[number, :, i] += 2.0 * x[:, j] * w_ij[i][j]
            if j == k_:
                u[number, :, i] += 2.0 * x[:, i] * w_ij[i][j]
        edge = mass / ((squares[k_] + lam) * delta)
        p[number] = 2.0 * x[:, k_] * rise[:, j] * edge - 2.0 * (j == k_) * i_k[:, k_]
    return -u / (8.0 * np.pi), p / (4.0 * np.pi)


def straining_flow(k, points, matrix):
    """All quantities by name at points (N, 3) outside, u = A x on the surface, A traceless."""
    theta = np.linspace(0.1, 3.0, 8)
    surface = Spheroid(k).surface(theta[:, None], np.linspace(0.3, 6.0, 7)).reshape(-1, 3)
    basis = _dipoles(k, surface)[0].reshape(9, -1).T
    size = np.linalg.norm(basis, axis=0)
    strength = np.linalg.lstsq(basis / size, (surface @ matrix.T).ravel(), rcond=1e-9)[0] / size

    def both(x):
        u, p = _dipoles(k, x)
        return np.tensordot(strength, u, 1), strength @ p

    return with_slopes(both, points)


def translating_flow(k, points, velocity):
    """Velocity (N, 3) and pressure (N,) at points (N, 3) outside a body of the given velocity (3,).

    Oberbeck 1876; Lamb, Hydrodynamics (1932), art. 339; the elliptic integrals of the confocal
    spheroid through each point in Carlson's form (DLMF 19.16).
    Semi-axes a = (k, k, 1) along the coordinates, fluid at rest far away, mu = 1. With
    chi = int dl / Delta and alpha_i = int dl / ((a_i^2 + l) Delta) over [lambda, inf), lambda the
    confocal parameter and size_i = V_i / (chi_0 + a_i^2 alpha_i0),

        u = sum_i size_i (e_i (chi + a_i^2 alpha_i) - x_i grad chi + a_i^2 x_i grad alpha_i),
        p = -2 sum_i size_i d chi / dx_i.
    """
    x, speed = np.asarray(points, dtype=float), np.asarray(velocity, dtype=float)
    squares = np.array([k * k, k * k, 1.0])
    rho2, z2 = x[:, 0] ** 2 + x[:, 1] ** 2, x[:, 2] ** 2
    half = 0.5 * (rho2 + z2 - k * k - 1.0)
    lam = np.maximum(half + np.sqrt(half * half + rho2 + k * k * z2 - k * k), 0.0)
    p, q = k * k + lam, 1.0 + lam
    chi, chi_0 = 2.0 * elliprf(p, p, q), 2.0 * elliprf(k * k, k * k, 1.0)
    across, along = 2.0 / 3.0 * elliprd(p, q, p), 2.0 / 3.0 * elliprd(p, p, q)
    across_0 = 2.0 / 3.0 * elliprd(k * k, 1.0, k * k)
    along_0 = 2.0 / 3.0 * elliprd(k * k, k * k, 1.0)
    scaled = x / (squares + lam[:, None])
    slope = 2.0 * scaled / np.sum(scaled**2, axis=1)[:, None]  # grad lambda
    fall = -slope / (p * np.sqrt(q))[:, None]  # grad chi
    u, pressure = np.zeros_like(x), np.zeros(len(x))
    for i, (alpha, alpha_0) in enumerate(((across, across_0),) * 2 + ((along, along_0),)):
        size = speed[i] / (chi_0 + squares[i] * alpha_0)
        u[:, i] += size * (chi + squares[i] * alpha)
        u -= size * x[:, [i]] * fall * (1.0 - squares[i] / (squares[i] + lam[:, None]))
        pressure -= 2.0 * size * fall[:, i]
    return u, pressure


def with_slopes(both, points):
    """Velocity and pressure of a function of complex points, and what follows from them."""
    u, p = both(points)
    gradient, slope = np.empty((len(points), 3, 3)), np.empty((len(points), 3))
    for j in range(3):
        du, dp = both(points + 1j * STEP * np.eye(3)[j])
        gradient[:, :, j], slope[:, j] = du.imag / STEP, dp.imag / STEP
    stress = gradient + gradient.swapaxes(1, 2) - p[:, None, None] * np.eye(3)
    return {
        "velocity": u,
        "gradient": gradient,
        "pressure": p,
        "pressure_gradient": slope,
        "stress": np.stack(
            [stress[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))], axis=-1
        ),
    }
