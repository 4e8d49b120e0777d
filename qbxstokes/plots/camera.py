"""A camera at infinity: points of space on paper, and which side of a sphere faces the viewer.

A parallel projection done by hand instead of matplotlib's 3-D axes: what is hidden is known
exactly, lengths across the line of sight are true, and vector files stay small.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.typing import Array


@dataclass(frozen=True)
class Camera:
    """Looks at the origin from the direction (azimuth, elevation), in degrees, with x3 upwards.

    up: another coordinate (0, 1, 2) upwards; azimuths then go round it.
    """

    azimuth: float = 25.0
    elevation: float = 22.0
    up: int = 2

    @cached_property
    def frame(self) -> Array:
        """Rows: right, up, and towards the viewer (3, 3)."""
        a, e = np.radians(self.azimuth), np.radians(self.elevation)
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        return np.roll(np.stack([right, np.cross(towards, right), towards]), self.up - 2, axis=1)

    def project(self, points: ArrayLike) -> Array:
        """Coordinates on paper (..., 2) of points (..., 3)."""
        return np.asarray(np.asarray(points, dtype=float) @ self.frame[:2].T)

    def depth(self, points: ArrayLike) -> Array:
        """Distance towards the viewer (...) of points (..., 3); positive is in front."""
        return np.asarray(np.asarray(points, dtype=float) @ self.frame[2])


def split_at_silhouette(points: Array, depth: Array) -> tuple[list[Array], list[Array]]:
    """A curve (n, 3) as its pieces before (depth >= 0) and behind the silhouette.

    The pieces meet at the points where the depth, linear between samples, is zero.
    """
    front: list[Array] = []
    back: list[Array] = []
    if not len(points):
        return front, back
    ahead = depth >= 0.0
    changes = np.flatnonzero(ahead[1:] != ahead[:-1])
    share = depth[changes] / (depth[changes] - depth[changes + 1])
    crossing = points[changes] + share[:, None] * (points[changes + 1] - points[changes])
    edges = [0, *(changes + 1).tolist(), len(points)]
    for index, (start, stop) in enumerate(pairwise(edges)):
        parts = [points[start:stop]]
        if index > 0:
            parts.insert(0, crossing[index - 1 : index])
        if index < len(changes):
            parts.append(crossing[index : index + 1])
        (front if ahead[start] else back).append(np.concatenate(parts))
    return front, back
