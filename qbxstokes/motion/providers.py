"""What the equations ask of hydrodynamics that are not a law with coefficients."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from qbxstokes.motion.lanes import PerLane

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


class LaneMotions:
    """Free motions of lanes of which each has a provider of its own.

    Rows are whole blocks one after the other: row i is of lane i modulo the number of lanes.
    """

    def __init__(self, providers: PerLane[Any], n_lanes: int) -> None:
        self._groups = list(providers.groups())
        self._n_lanes = n_lanes

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """U and Omega, each (n, 3), at centres x (n, 3) and unit quaternions q (n, 4)."""
        return self._asked("free_motion", t, x, q)

    def _asked(self, name: str, t: float, *rows: Array) -> tuple[Array, Array]:
        blocks = [row.reshape(-1, self._n_lanes, row.shape[-1]) for row in rows]
        first, second = np.empty((2, *blocks[0].shape))
        for provider, lanes in self._groups:
            parts = [block[:, lanes] for block in blocks]
            flat = [part.reshape(-1, part.shape[-1]) for part in parts]
            for whole, part in zip((first, second), getattr(provider, name)(t, *flat), strict=True):
                whole[:, lanes] = np.reshape(part, parts[0].shape)
        return first.reshape(-1, 3), second.reshape(-1, 3)


class LaneForces(LaneMotions):
    """The same of providers that find force and torque directly."""

    def force_torque(
        self, t: float, x: Array, q: Array, v: Array, omega: Array
    ) -> tuple[Array, Array]:
        """Hydrodynamic force and torque on the bodies, each (n, 3), in the space frame."""
        return self._asked("force_torque", t, x, q, v, omega)


def provider_of(providers: PerLane[FreeMotion], n_lanes: int) -> FreeMotion:
    """One provider for all lanes."""
    if providers.shared:
        return providers.only
    forces = all(isinstance(entry, ForceTorque) for entry in providers.distinct)
    return LaneForces(providers, n_lanes) if forces else LaneMotions(providers, n_lanes)
