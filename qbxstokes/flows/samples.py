"""Samples of gradients along paths, (paths, T, components), read from files in parts or made.

Those that are made are isotropic, Gaussian and smooth in time, a model of turbulence:
A(t) = sum_c g_c(t) B_c over an orthogonal basis of five strains and three rotations; the g_c are
independent Gaussian processes of correlation exp(-t^2/(2 tau^2)), each the sum of some waves with
normal amplitudes and frequencies (Kraichnan, Phys. Fluids 13, 1970). As in homogeneous turbulence
the mean square of the vorticity is 2 <E:E>.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from qbxstokes.errors import FlowError
from qbxstokes.typing import Array, Integers

WAVES = 24  # of each component of random gradients


class Samples:
    """Samples of which parts are read as they are asked for, by paths and instants.

    read: gives those of a slice of the paths, or of one by its number, at a slice of the instants.
    """

    ndim = 3

    def __init__(self, read: Callable[[Any, slice], Any], shape: tuple[int, int, int]) -> None:
        self._read, self.shape = read, shape

    def __getitem__(self, place: tuple[Any, slice]) -> Any:
        """By paths and instants."""
        return self._read(*place)

    def times(self, factor: float) -> Samples:
        """The same, times a number."""
        return Samples(lambda paths, instants: factor * self[paths, instants], self.shape)


def view(whole: Any, numbers: Integers | None, first: int, last: int) -> Samples:
    """Some paths of samples, by their numbers, None for all, from one instant to another."""
    count = whole.shape[0] if numbers is None else len(numbers)

    def read(paths: Any, instants: slice) -> Any:
        start, stop, step = instants.indices(last - first)
        instants = slice(first + start, first + stop, step)
        if numbers is None:
            return whole[paths, instants]
        if not isinstance(paths, slice):
            return whole[int(numbers[paths]), instants]
        rows = [whole[int(number), instants] for number in numbers[paths]]
        return np.stack(rows) if rows else np.empty((0, stop - start, whole.shape[2]))

    return Samples(read, (count, last - first, whole.shape[2]))


def in_file(data: Any, time_first: bool) -> Samples:
    """Those of a dataset (paths, T) or (T, paths), with eight, nine or three by three numbers."""
    n, m = data.shape[:2]
    width = 9 if data.ndim == 4 else data.shape[2]

    def read(paths: Any, instants: slice) -> Any:
        part = data[instants, paths] if time_first else data[paths, instants]
        if data.ndim == 4:
            part = part.reshape(*part.shape[:-2], 9)
        return np.swapaxes(part, 0, 1) if time_first and part.ndim == 3 else part

    return Samples(read, (m, n, width) if time_first else (n, m, width))


def in_rows(data: Any, starts: Integers, count: int) -> Samples:
    """Those of paths that follow one another in a dataset (rows, components) or (rows, 3, 3).

    starts (paths,): the first row of each; count: of rows taken of each.
    """
    width = 9 if data.ndim == 3 else data.shape[1]

    def read(paths: Any, instants: slice) -> Any:
        chosen = np.atleast_1d(starts[paths])
        inside = np.arange(*instants.indices(count))
        if not len(chosen) or not len(inside):
            return np.empty((len(chosen), len(inside), width))
        first, last = int(chosen.min()), int(chosen.max())
        block = data[first + inside[0] : last + inside[-1] + 1]
        found = block.reshape(len(block), -1)[(chosen - first)[:, None] + inside - inside[0]]
        return found if isinstance(paths, slice) else found[0]

    return Samples(read, (len(starts), count, width))


def random_samples(
    times: Array, paths: int, rate: float, correlation_time: float, seed: int
) -> Samples:
    """Those of paths at random, of which each depends on its number alone.

    rate: sqrt(2 <E:E>). Raises FlowError for impossible numbers.
    """
    for name, value in (("paths", paths), ("correlation_time", correlation_time)):
        if not value > 0:
            raise FlowError(f"{name} is {value}, and must be more than 0", ("gradient", name))
    # <E:E> = 5 of unit processes would be rate^2/2, and the vorticity squared 3 of them rate^2.
    basis = _basis() * rate * np.sqrt([0.1] * 5 + [1.0 / 3.0] * 3)[:, None]

    def path(number: int, instants: Array) -> Array:
        generator = np.random.default_rng([seed, number])
        frequency = generator.standard_normal((8, WAVES)) / correlation_time
        one, other = generator.standard_normal((2, 8, WAVES)) / np.sqrt(WAVES)
        angle = frequency[..., None] * instants
        waves = one[..., None] * np.cos(angle) + other[..., None] * np.sin(angle)
        return np.asarray(waves.sum(axis=1).T @ basis)

    def read(chosen: Any, instants: slice) -> Any:
        if not isinstance(chosen, slice):
            return path(int(chosen), times[instants])
        rows = [path(number, times[instants]) for number in range(*chosen.indices(paths))]
        return np.stack(rows) if rows else np.empty((0, len(times), 9))

    return Samples(read, (paths, len(times), 9))


def _basis() -> Array:
    """Five strains with B:B = 1 and three rotations with vorticity squared 1, (8, 9)."""
    found = np.zeros((8, 3, 3))
    found[0] = np.diag([1.0, -1.0, 0.0]) / np.sqrt(2.0)
    found[1] = np.diag([1.0, 1.0, -2.0]) / np.sqrt(6.0)
    for place, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        found[2 + place, i, j] = found[2 + place, j, i] = np.sqrt(0.5)
        found[5 + place, i, j], found[5 + place, j, i] = 0.5, -0.5
    return found.reshape(8, 9)
