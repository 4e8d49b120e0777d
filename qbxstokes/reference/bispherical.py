"""Two spheres, or a sphere by a plane wall, by series in bispherical coordinates.

A Stokes flow is u = x Q/2 + H with the pressure Q and the Cartesian components of H harmonic
(Dean & O'Neill 1963, Mathematika 10; O'Neill 1964, Mathematika 11; Lee & Leal 1980, J. Fluid Mech.
98). With z = c sinh(xi)/(cosh xi - cos eta), rho = c sin(eta)/(cosh xi - cos eta) every harmonic
function of azimuthal order m is

    (cosh xi - cos eta)^(1/2) sum_n [a_n e^(N(xi - xi_1)) + b_n e^(-N(xi - xi_2))] P_n^m(cos eta)

with N = n + 1/2.

The coefficients satisfy the boundary values and div u = 0, which is harmonic and so holds in the
fluid if it holds on both surfaces. Both are taken at Gauss nodes in cos eta: as many equations as
unknowns. Velocities in the plane of the axis vary as cos(phi) (order 1) or not at all (order 0).

Everything has mu = 1; forces and torques are those of the bodies ON the fluid.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from qbxstokes.typing import Array


@dataclass(frozen=True)
class Bispherical:
    """Spheres of radius `upper` and `lower` with a gap between them; lower = inf is a plane wall.

    The wall, or the plane xi = 0, is z = 0; the upper sphere's centre is at z > 0. terms: of each
    series.
    """

    upper: float
    lower: float
    gap: float
    terms: int = 0

    @cached_property
    def _shape(self) -> tuple[float, float, float]:
        """c, xi_1 and xi_2 <= 0."""
        a, b, g = self.upper, self.lower, self.gap
        if math.isinf(b):
            xi = math.acosh(1.0 + g / a)
            return a * math.sinh(xi), xi, 0.0
        d = a + b + g
        z1 = (d * d + a * a - b * b) / (2.0 * d)
        c = math.sqrt(z1 * z1 - a * a)
        return c, math.asinh(c / a), -math.asinh(c / b)

    @cached_property
    def n(self) -> int:
        """Terms: enough for rounding unless given."""
        return self.terms or int(24 + 42.0 / (self._shape[1] - self._shape[2]))

    @property
    def centres(self) -> tuple[float, float]:
        """Heights of the centres; -inf for a wall."""
        c, xi1, xi2 = self._shape
        return c / math.tanh(xi1), c / math.tanh(xi2) if xi2 else -math.inf

    @cached_property
    def _nodes(self) -> tuple[Array, Array]:
        x, w = np.polynomial.legendre.leggauss(self.n)
        return x, w

    def _normal(self, side: int) -> tuple[Array, Array, Array]:
        """Components along z and rho of the normal into the fluid, and the weights of area."""
        c, *places = self._shape
        x, w = self._nodes
        xi, sign = places[side], (-1.0, 1.0)[side]  # towards smaller xi above, larger below
        base = math.cosh(xi) - x
        n_z = sign * (1.0 - math.cosh(xi) * x) / base
        n_rho = sign * -math.sinh(xi) * np.sqrt(1.0 - x * x) / base
        return n_z, n_rho, w * (c / base) ** 2  # d eta sin(eta) times both scale factors

    def _legendre(self, m: int) -> tuple[Array, Array]:
        """P_n^m, normalised, n = m..m + N - 1, and its derivative in eta, (nodes, N)."""
        x, _ = self._nodes
        s = np.sqrt(1.0 - x * x)
        top = m + self.n + 1
        p = np.zeros((top + 1, len(x)))
        p[m] = np.sqrt(0.5)
        for j in range(1, m + 1):
            p[m] *= np.sqrt((2.0 * j + 1.0) / (2.0 * j)) * s
        p[m + 1] = np.sqrt(2.0 * m + 3.0) * x * p[m]
        for j in range(m + 1, top):
            below = (2.0 * j + 3) / ((j + 1.0) ** 2 - m * m)
            down = np.sqrt(below * (j * j - m * m) / (2.0 * j - 1))
            p[j + 1] = np.sqrt((2.0 * j + 1) * below) * x * p[j] - down * p[j - 1]
        degree = np.arange(m, m + self.n)[:, None]
        before = np.concatenate([np.zeros((1, len(x))), p[m : m + self.n - 1]])
        square = (2.0 * degree + 1) / np.maximum(2 * degree - 1, 1) * (degree**2 - m * m)
        factor = np.sqrt(np.maximum(square, 0.0))
        slope = (degree * x * p[m : m + self.n] - factor * before) / s
        return p[m : m + self.n].T, slope.T

    def _harmonics(self, m: int, side: int) -> tuple[Array, Array, Array, Array]:
        """Values, d_rho, d_z and d_xi, (nodes, 2N), on the upper (0) or the lower surface (1)."""
        c, xi1, xi2 = self._shape
        xi = (xi1, xi2)[side]
        x, _ = self._nodes
        s = np.sqrt(1.0 - x * x)
        p, slope = self._legendre(m)
        half = np.arange(m, m + self.n) + 0.5
        up, down = np.exp(half * (xi - xi1)), np.exp(-half * (xi - xi2))
        both = np.concatenate([up, down])
        rate = np.concatenate([half * up, -half * down])
        p, slope = np.tile(p, 2), np.tile(slope, 2)
        base = math.cosh(xi) - x
        root = np.sqrt(base)[:, None]
        value = root * both * p
        d_xi = root * rate * p + 0.5 * math.sinh(xi) / root * both * p
        d_eta = root * both * slope + (0.5 * s)[:, None] / root * both * p
        # d xi and d eta along z and rho.
        xi_z, xi_rho = (1.0 - math.cosh(xi) * x) / c, -math.sinh(xi) * s / c
        eta_z, eta_rho = xi_rho, -xi_z
        d_z = xi_z[:, None] * d_xi + eta_z[:, None] * d_eta
        d_rho = xi_rho[:, None] * d_xi + eta_rho[:, None] * d_eta
        return value, d_rho, d_z, d_xi

    def _place(self, side: int) -> tuple[Array, Array, Array]:
        c, xi1, xi2 = self._shape
        x, _ = self._nodes
        xi = (xi1, xi2)[side]
        base = math.cosh(xi) - x
        return c * np.sqrt(1.0 - x * x) / base, c * math.sinh(xi) / base, base

    def _solve(self, m: int, velocity: list[tuple[Array, Array, Array]]) -> Array:
        """Force and torque (2, 4): F_z, F_x, T_y, T_z of the upper and the lower surface.

        velocity: u_rho, u_phi (order 0: swirl), u_z at the nodes of each surface; with order 1 the
        amplitudes of cos(phi), sin(phi) and cos(phi).
        """
        parts = (0, 1, 0) if m == 0 else (1, 2, 0, 1)  # orders of Q, H_..., H_z
        rows, right, keep = [], [], []
        for side in (0, 1):
            rho, z, base = (v[:, None] for v in self._place(side))
            h = {order: self._harmonics(order, side) for order in {*parts}}
            q, w = h[m], h[m]
            stretch = 0.5 * (3.0 * q[0] + rho * q[1] + z * q[2])
            zero = np.zeros_like(q[0])
            if m == 0:
                u1 = h[1]
                blocks = [
                    [0.5 * rho * q[0], u1[0], zero],
                    [0.5 * z * q[0], zero, w[0]],
                    [stretch, u1[1] + u1[0] / rho, w[2]],
                ]
                values = [velocity[side][0], velocity[side][2]]
            else:
                u2, u0 = h[2], h[0]
                blocks = [
                    [0.5 * rho * q[0], 0.5 * u2[0], 0.5 * u0[0], zero],
                    [zero, 0.5 * u2[0], -0.5 * u0[0], zero],
                    [0.5 * z * q[0], zero, zero, w[0]],
                    [stretch, 0.5 * (u2[1] + 2.0 * u2[0] / rho), 0.5 * u0[1], w[2]],
                ]
                values = list(velocity[side])
            weight = np.sqrt(self._nodes[1])[:, None]
            rows += [np.concatenate(block, axis=1) * weight / np.sqrt(base) for block in blocks]
            right += [(v[:, None] * weight / np.sqrt(base))[:, 0] for v in values]
            right.append(np.zeros(self.n))
            keep.append(h)
        matrix, data = np.concatenate(rows), np.concatenate(right)
        scale = np.linalg.norm(matrix, axis=0)
        scale[scale == 0.0] = 1.0
        solution = np.linalg.lstsq(matrix / scale, data, rcond=1e-14)[0] / scale
        coefficients = solution.reshape(len(parts), -1)
        return np.stack([self._traction(m, side, coefficients, keep[side]) for side in (0, 1)])

    def _traction(
        self, m: int, side: int, c: Array, h: dict[int, tuple[Array, Array, Array, Array]]
    ) -> Array:
        """Integrals of p n - du/dn - (rigid part) over a surface, by its nodes.

        On a rigid surface sigma.n = -p n + du/dn + (grad u)^T n; the last two are taken whole.
        """
        rho, z, _ = self._place(side)
        n_z, n_rho, area = self._normal(side)

        def each(which: int, order: int) -> tuple[Array, Array, Array]:
            value, along_rho, along_z, _ = h[order]
            return value @ c[which], along_rho @ c[which], along_z @ c[which]

        if m == 0:
            q, u1, hz = each(0, 0), each(1, 1), each(2, 0)
            rz = 0.5 * rho * q[2] + u1[2]
            zr = 0.5 * z * q[1] + hz[1]
            zz = 0.5 * (q[0] + z * q[2]) + hz[2]
            t_z = -q[0] * n_z + 2.0 * zz * n_z + (zr + rz) * n_rho
            return np.array([-2.0 * np.pi * (area @ t_z), 0.0, 0.0, 0.0])
        q, u2, u0, hz = each(0, 1), each(1, 2), each(2, 0), each(3, 1)
        u_rho = 0.5 * (rho * q[0] + u2[0] + u0[0])
        u_phi = 0.5 * (u2[0] - u0[0])
        u_z = 0.5 * z * q[0] + hz[0]
        rr = 0.5 * (q[0] + rho * q[1] + u2[1] + u0[1])
        rz = 0.5 * (rho * q[2] + u2[2] + u0[2])
        pr, pz = 0.5 * (u2[1] - u0[1]), 0.5 * (u2[2] - u0[2])
        zr, zz = 0.5 * z * q[1] + hz[1], 0.5 * (q[0] + z * q[2]) + hz[2]
        t_rho = -q[0] * n_rho + 2.0 * rr * n_rho + (rz + zr) * n_z
        t_phi = (pr - u_phi / rho - u_rho / rho) * n_rho + (pz - u_z / rho) * n_z
        t_z = -q[0] * n_z + 2.0 * zz * n_z + (rz + zr) * n_rho
        f_x = np.pi * (area @ (t_rho - t_phi))
        centre = self.centres[side] if math.isfinite(self.centres[side]) else 0.0
        t_y = np.pi * (area @ ((z - centre) * (t_rho - t_phi) - rho * t_z))
        return np.array([0.0, -f_x, -t_y, 0.0])

    def _rigid(self, m: int, kind: str, side: int) -> list[tuple[Array, Array, Array]]:
        found = []
        for here in (0, 1):
            rho, z, _ = self._place(here)
            zero, one = np.zeros_like(rho), np.ones_like(rho)
            if here != side:
                found.append((zero, zero, zero))
            elif kind == "along":
                found.append((zero, zero, one))
            elif kind == "across":
                found.append((one, -one, zero))
            else:  # about y: u = (z - z_c) e_x - x e_z
                arm = z - self.centres[side]
                found.append((arm, -arm, -rho))
        return found

    def along(self) -> Array:
        """Forces (2, 2) along the axis on the fluid per velocity: [body, moving body]."""
        columns = [self._solve(0, self._rigid(0, "along", side))[:, 0] for side in self._bodies]
        return np.asarray(np.stack(columns, axis=1)[self._bodies])

    def across(self) -> Array:
        """Force along x and torque about y on the fluid, [F1, T1, F2, T2], per [U1, W1, U2, W2]."""
        columns = []
        for side in self._bodies:
            for kind in ("across", "spin"):
                found = self._solve(1, self._rigid(1, kind, side))
                columns.append(found[self._bodies, 1:3].ravel())
        return np.stack(columns, axis=1)

    def about(self) -> Array:
        """Torques about the axis on the fluid per angular velocity, [body, spinning body]."""
        columns = []
        for side in self._bodies:
            rows, right = [], []
            for here in (0, 1):
                rho, _, base = self._place(here)
                value = self._harmonics(1, here)[0]
                rows.append(value / np.sqrt(base)[:, None])
                right.append((rho if here == side else 0.0 * rho) / np.sqrt(base))
            c = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=1e-14)[0]
            columns.append([self._swirl(here, c) for here in self._bodies])
        return np.array(columns).T

    def _swirl(self, side: int, c: Array) -> float:
        rho, _, _ = self._place(side)
        n_z, n_rho, area = self._normal(side)
        value, d_rho, d_z, _ = (part @ c for part in self._harmonics(1, side))
        traction = (d_rho - value / rho) * n_rho + d_z * n_z
        return float(-2.0 * np.pi * np.sum(area * rho * traction))

    @property
    def _bodies(self) -> list[int]:
        return [0] if math.isinf(self.lower) else [0, 1]

    def held_in_shear(self) -> Array:
        """Force along x and torque about y (2,) ON the upper sphere held in u = z e_x."""
        velocity = []
        for side in (0, 1):
            _, z, _ = self._place(side)
            u = -z if side == 0 else 0.0 * z
            velocity.append((u, -u, 0.0 * z))
        disturbance = self._solve(1, velocity)[0, 1:3]
        # The background's own traction adds no force and, over a closed surface, no torque.
        return -disturbance


def near_wall(height: float) -> dict[str, float]:
    """A unit sphere by a wall: resistances over Stokes's, as Goldman, Cox & Brenner (1967) give.

    normal, parallel (f/(6 pi)), rotation_normal, rotation_parallel (t/(8 pi)) and coupling: force
    on the fluid over 6 pi per angular velocity; shear_force over 6 pi h, shear_torque over 4 pi:
    force and torque ON the sphere held in unit shear.
    """
    scene, six, eight = Bispherical(1.0, math.inf, height - 1.0), 6.0 * np.pi, 8.0 * np.pi
    across, held = scene.across(), scene.held_in_shear()
    return {
        "normal": float(scene.along()[0, 0]) / six,
        "parallel": float(across[0, 0]) / six,
        "rotation_parallel": float(across[1, 1]) / eight,
        "rotation_normal": float(scene.about()[0, 0]) / eight,
        "coupling": float(across[0, 1]) / six,
        "shear_force": float(held[0]) / (six * height),
        "shear_torque": float(held[1]) / (4.0 * np.pi),
    }


def brenner(height: float) -> float:
    """Normal resistance of a unit sphere by a wall over 6 pi (Brenner 1961, eq. 2.19)."""
    a = math.acosh(height)
    n = np.arange(1.0, min(2000.0, 300.0 / a))
    top = 2.0 * np.sinh((2 * n + 1) * a) + (2 * n + 1) * math.sinh(2 * a)
    bottom = 4.0 * np.sinh((n + 0.5) * a) ** 2 - (2 * n + 1) ** 2 * math.sinh(a) ** 2
    terms = n * (n + 1) / ((2 * n - 1) * (2 * n + 3)) * (top / bottom - 1.0)
    return float(4.0 / 3.0 * math.sinh(a) * np.sum(terms))
