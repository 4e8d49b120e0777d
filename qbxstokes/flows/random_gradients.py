"""Velocity gradients at random: isotropic, Gaussian and smooth in time, a model of turbulence.

A(t) = sum_c g_c(t) B_c over an orthogonal basis of five strains and three rotations; the g_c are
independent Gaussian processes of correlation exp(-t^2/(2 tau^2)), each the sum of some waves with
normal amplitudes and frequencies (Kraichnan, Phys. Fluids 13, 1970). As in homogeneous turbulence
the mean square of the vorticity is 2 <E:E>.
"""

from typing import Any

import numpy as np

from qbxstokes.errors import FlowError
from qbxstokes.typing import Array

WAVES = 24  # of each component


def basis() -> Array:
    """Five strains with B:B = 1 and three rotations with vorticity squared 1, (8, 9)."""
    found = np.zeros((8, 3, 3))
    found[0] = np.diag([1.0, -1.0, 0.0]) / np.sqrt(2.0)
    found[1] = np.diag([1.0, 1.0, -2.0]) / np.sqrt(6.0)
    for place, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        found[2 + place, i, j] = found[2 + place, j, i] = np.sqrt(0.5)
        found[5 + place, i, j], found[5 + place, j, i] = 0.5, -0.5
    return found.reshape(8, 9)


class RandomSamples:
    """Samples (paths, T, 9) that are made as they are asked for; a path depends on its number.

    rate: sqrt(2 <E:E>). Raises FlowError for impossible numbers.
    """

    ndim, dtype = 3, np.dtype(np.float64)

    def __init__(
        self, times: Array, paths: int, rate: float, correlation_time: float, seed: int
    ) -> None:
        for name, value in (("paths", paths), ("correlation_time", correlation_time)):
            if not value > 0:
                raise FlowError(f"{name} is {value}, and must be more than 0", ("gradient", name))
        self.shape = (paths, len(times), 9)
        self._times, self._seed, self._time = times, seed, correlation_time
        # <E:E> = 5 of unit processes would be rate^2/2, and the vorticity squared 3 of them rate^2.
        self._basis = basis() * rate * np.sqrt([0.1] * 5 + [1.0 / 3.0] * 3)[:, None]

    def __getitem__(self, place: Any) -> Array:
        """By paths, a number or a slice, and instants."""
        paths, instants = place
        if isinstance(paths, slice):
            numbers = range(*paths.indices(self.shape[0]))
            rows = [self._path(number, self._times[instants]) for number in numbers]
            return np.stack(rows) if rows else np.empty((0, *self.shape[1:]))
        return self._path(int(paths), self._times[instants])

    def _path(self, number: int, times: Array) -> Array:
        generator = np.random.default_rng([self._seed, number])
        frequency = generator.standard_normal((8, WAVES)) / self._time
        one, other = generator.standard_normal((2, 8, WAVES)) / np.sqrt(WAVES)
        angle = frequency[..., None] * times
        waves = one[..., None] * np.cos(angle) + other[..., None] * np.sin(angle)
        return np.asarray(waves.sum(axis=1).T @ self._basis)
