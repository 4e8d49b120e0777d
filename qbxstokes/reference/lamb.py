"""Drag on a translating spheroid (Lamb, Hydrodynamics, 6th ed., art. 339; Oberbeck 1876)."""

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.reference.integrals import alpha0, chi0, gamma0
from qbxstokes.typing import Array


def translation_resistance(k: float) -> tuple[float, float]:
    """(transverse, axial) resistance R in F = -R V, units mu c; 6 pi for a sphere.

    R = 16 pi/(chi0 + k^2 alpha0) across the axis and 16 pi/(chi0 + gamma0) along it.
    """
    chi = chi0(k)
    return 16.0 * np.pi / (chi + k * k * alpha0(k)), 16.0 * np.pi / (chi + gamma0(k))


def drag(k: float, velocity: ArrayLike) -> Array:
    """Force (..., 3) on a spheroid translating with `velocity` (..., 3), both in the body frame."""
    transverse, axial = translation_resistance(k)
    result: Array = -np.array([transverse, transverse, axial]) * np.asarray(velocity, dtype=float)
    return result
