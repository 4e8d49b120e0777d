"""Surfaces of bodies as shaded facets, for animations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from qbxstokes.geometry.shape import Revolution
from qbxstokes.typing import Array

SHADES = ("#3f8fc0", "#d8e6ef")
_SECTORS = 4  # of longitude, in two shades, so that the turning about the axis is seen
_LIGHT = np.array([-0.45, 0.65, 0.61])  # right, up, towards the viewer


def lit(shade: NDArray[np.intp], light: Array) -> Array:
    """Colours (n, 3) of surface in the shades (n,) where light (n,) in [0, 1] falls on it."""
    from matplotlib.colors import to_rgb

    base = np.array([to_rgb(color) for color in SHADES])[shade]
    colors: Array = base * (0.5 + 0.5 * light[:, None]) + 0.25 * light[:, None] ** 12
    return np.clip(colors, 0.0, 0.96)


def colours(shade: Array, seen: Array) -> Array:
    """Colours (n, 3) of facets of a shade (n,) with normals (n, 3) as the camera sees them."""
    light = np.clip(seen @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0)
    return lit(shade.astype(int), light)


def mesh(shape: Revolution) -> tuple[Array, Array, Array]:
    """Corners (n, 4, 3), normals (n, 3) and shade (n,) of the facets, in the body frame."""
    theta = np.linspace(0.0, np.pi, 31)
    phi = np.linspace(0.0, 2.0 * np.pi, 61)
    corners = shape.surface(theta[:, None], phi[None, :])
    facets = np.stack(
        [corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]], axis=2
    ).reshape(-1, 4, 3)
    middle = 0.5 * (theta[1:] + theta[:-1]), 0.5 * (phi[1:] + phi[:-1])
    normals = shape.normal(middle[0][:, None], middle[1][None, :]).reshape(-1, 3)
    sector = np.floor(middle[1] / (2.0 * np.pi) * _SECTORS).astype(int) % 2
    return facets, normals, np.tile(sector, len(middle[0])).astype(float)
