"""What a dilute suspension is made of: its particle, a homogeneous flow, and the flow's history."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from qbxstokes.typing import Array

Protocol = Literal["steady", "startup", "cessation", "oscillation"]


@dataclass(frozen=True)
class Particle:
    """What the rheology of a dilute suspension needs of a body of revolution.

    stresslet: S0, S1, S2 (3,), free of torque (`bie.stresslet`). linear: lambda, of Omega = w/2 +
    lambda p x (E p). resistance: zeta, transverse to rotation. volume: V. Lengths in c, mu = 1.
    """

    stresslet: Array
    linear: float
    resistance: float
    volume: float

    def hydrodynamic_stress(self, second: Array, fourth: Array, strain: Array) -> Array:
        """<S>/V (..., 3, 3) of the moments <pp>, <pppp> in the strain rate E (..., 3, 3).

        Per volume fraction and mu (G. K. Batchelor 1970, J. Fluid Mech. 41, 545).
        """
        s0, s1, s2 = self.stresslet
        product = np.matmul(second, strain)
        found = (1.5 * s0 - 2.0 * s1 + 0.5 * s2) * np.einsum("...ijkl,...kl->...ij", fourth, strain)
        found = found + (s1 - s2) * (product + np.swapaxes(product, -1, -2)) + s2 * strain
        trace = np.einsum("...ij,...ij->...", second, strain)
        found = found + 0.5 * (s2 - s0) * trace[..., None, None] * np.eye(3)
        return np.asarray(found / self.volume)

    def brownian_stress(self, second: Array, diffusivity: float | Array) -> Array:
        """3 kT lambda (<pp> - I/3)/V (..., 3, 3), kT = D zeta (E. J. Hinch & L. G. Leal 1972)."""
        strength = 3.0 * np.asarray(diffusivity) * self.resistance * self.linear / self.volume
        return np.asarray(strength[..., None, None] * (second - np.eye(3) / 3.0))

    @property
    def viscosity_of_isotropic(self) -> float:
        """[eta] of orientations without preference and without their Brownian stress.

        (S0 + 2 S1 + 2 S2)/(10 V); 5/2 for a sphere (Einstein).
        """
        s0, s1, s2 = self.stresslet
        return float((s0 + 2.0 * s1 + 2.0 * s2) / (10.0 * self.volume))

    @property
    def viscosity_at_rest(self) -> float:
        """[eta] in the limit of small Peclet numbers: zeta lambda^2/(10 V) more.

        That of R. Simha 1940, J. Phys. Chem. 44, 25, and H. A. Scheraga 1955, J. Chem. Phys. 23,
        1526; at a frequency w of small amplitude the part more is over 1 + i w/(6 D).
        """
        brownian = self.resistance * self.linear**2 / (10.0 * self.volume)
        return self.viscosity_of_isotropic + brownian


@dataclass(frozen=True)
class LinearFlow:
    """A homogeneous flow u = G x by its rate, strain rate and the directions of its shear.

    rate = sqrt(2 E:E). axes: directions of stream, gradient and vorticity (rows) of a simple shear,
    None for another flow, which has no normal stress differences.
    """

    gradient: Array
    rate: float
    axes: Array | None

    @property
    def strain(self) -> Array:
        """E (3, 3) over the rate."""
        return 0.5 * (self.gradient + self.gradient.T) / self.rate

    @property
    def spin(self) -> Array:
        """Half the vorticity (3,) over the rate."""
        g = self.gradient / self.rate
        return 0.5 * np.array([g[2, 1] - g[1, 2], g[0, 2] - g[2, 0], g[1, 0] - g[0, 1]])

    def material_functions(self, stress: Array) -> dict[str, Array]:
        """[eta], N1 and N2 (...) of stresses (..., 3, 3) over volume fraction, mu and rate.

        [eta] = Sigma:E/(2 E:E), which in a shear is Sigma_12; N1 = Sigma_11 - Sigma_22 and
        N2 = Sigma_22 - Sigma_33 in the directions of stream, gradient and vorticity.
        """
        found = {"intrinsic_viscosity": np.einsum("...ij,ij->...", stress, self.strain)}
        differences = np.full((2, *stress.shape[:-2]), np.nan)
        if self.axes is not None:
            along, across, third = (
                np.einsum("...ij,i,j->...", stress, axis, axis) for axis in self.axes
            )
            differences = np.stack([along - across, across - third])
        found["first_normal_stress_difference"] = differences[0]
        found["second_normal_stress_difference"] = differences[1]
        return found


@dataclass(frozen=True)
class History:
    """Rate and strain over time, by the flow's rate.

    instants: (T,), at which something is asked for; None of a steady state. cycle: angular
    frequency w over the rate of an oscillation, whose rate is cos(w t).
    """

    protocol: Protocol
    instants: Array | None = None
    cycle: float | None = None

    def rate(self, t: float) -> float:
        """Of the flow at a time t >= 0, over its own."""
        if self.cycle is not None:
            return math.cos(self.cycle * t)
        return 0.0 if self.protocol == "cessation" else 1.0

    def strain(self, times: Array) -> Array:
        """Strain (n,) since time 0; a flow that is stopped then has gone on before."""
        if self.cycle is not None:
            return np.asarray(np.sin(self.cycle * times) / self.cycle)
        return np.asarray(np.minimum(times, 0.0) if self.protocol == "cessation" else times)

    @property
    def rates(self) -> Array:
        """Rates (T,) at the instants; () of a steady state."""
        if self.instants is None:
            return np.ones(())
        return np.array([self.rate(t) for t in self.instants.tolist()])

    def lead(self, shortest: float) -> float:
        """Time before 0 that the orientations are given, whole cycles of an oscillation."""
        if self.protocol == "startup":
            return 0.0
        if self.cycle is None:
            return shortest
        period = 2.0 * math.pi / self.cycle
        return period * math.ceil(shortest / period)
