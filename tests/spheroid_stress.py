"""Stresslet of a spheroid in a flow by closed forms, from the numbers of `reference.stress`."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.reference.faxen import surface_means
from qbxstokes.reference.jeffery import free_angular_velocity, rotation_resistance
from qbxstokes.reference.stress import held_number, stresslet_numbers
from qbxstokes.typing import Array


def kim_karrila(k: float) -> tuple[float, float, float]:
    """(X^M, Y^M, Z^M), the stresslets of the held spheroid over (20 pi/3) mu a^3, a the long axis.

    S0, the held S1 and S2, in the units of Kim & Karrila 1991, tables 3.4 and 3.6.
    """
    scale = 20.0 * math.pi / 3.0 * max(1.0, k) ** 3
    axial, _, across = stresslet_numbers(k)
    return axial / scale, held_number(k) / scale, across / scale


def tensor(numbers: tuple[float, float, float], axis: ArrayLike, strain: ArrayLike) -> Array:
    """Stresslet (3, 3) of the form above, for p = axis (3,) and E = strain (3, 3)."""
    p, e = np.asarray(axis, dtype=float), np.asarray(strain, dtype=float)
    unit, pp = np.eye(3), np.outer(p, p)
    along = float(p @ e @ p)
    w = e @ p - p * along
    across = (unit - pp) @ e @ (unit - pp) + 0.5 * along * (unit - pp)
    s0, s1, s2 = numbers
    result: Array = (
        1.5 * s0 * along * (pp - unit / 3.0) + s1 * (np.outer(p, w) + np.outer(w, p)) + s2 * across
    )
    return result


def stresslet(
    k: float,
    rotation: ArrayLike,
    centre: ArrayLike,
    velocity: Callable[[Array], Array],
    angular_velocity: ArrayLike | None = None,
    order: int = 40,
) -> Array:
    """Stresslet (3, 3), space frame, of a spheroid in any Stokes flow: Faxen's law for it.

    S = R_S : <e>_V with <e>_V the mean strain rate over the volume, exact for the ellipsoid in
    every Stokes flow. angular_velocity (3,), space: of the body; None: free of torque. Arguments as
    `faxen.surface_means`.
    """
    turn = np.asarray(rotation, dtype=float)
    _, gradient = surface_means((k, k, 1.0), turn, centre, velocity, order)
    axis = np.array([0.0, 0.0, 1.0])
    body = tensor(stresslet_numbers(k), axis, 0.5 * (gradient + gradient.T))
    if angular_velocity is not None:
        spin = turn.T @ np.asarray(angular_velocity, dtype=float)
        torque = -rotation_resistance(k)[0] * (spin - free_angular_velocity(k, gradient))
        across = np.cross(torque, axis)
        beta = (1.0 - k * k) / (1.0 + k * k)
        body = body + 0.5 * beta * (np.outer(axis, across) + np.outer(across, axis))
    return np.asarray(turn @ body @ turn.T)
