"""What the equations ask of hydrodynamics that are not a law with coefficients."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@runtime_checkable
class FreeMotion(Protocol):
    """Anything that knows the free motion of bodies at (x, q), in the space frame."""

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """U and Omega, each (n, 3), at centres x (n, 3) and unit quaternions q (n, 4)."""
        ...


@runtime_checkable
class ForceTorque(FreeMotion, Protocol):
    """A free motion that also finds force and torque directly (the check of the shortcut)."""

    def force_torque(
        self, t: float, x: Array, q: Array, v: Array, omega: Array
    ) -> tuple[Array, Array]:
        """Hydrodynamic force and torque on the bodies, each (n, 3), in the space frame."""
        ...
