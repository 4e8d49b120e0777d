"""Samples of gradients along paths, (paths, T, components), read from files in parts."""

from __future__ import annotations

from typing import Any

import numpy as np

from qbxstokes.typing import Integers


class View:
    """Some paths and instants of samples (paths, T, components), read as they are asked for.

    numbers: of the paths in their order, None for all. instants: first and last but one.
    """

    ndim = 3

    def __init__(self, whole: Any, numbers: Integers | None, instants: tuple[int, int]) -> None:
        self._whole, self._numbers, self._first = whole, numbers, instants[0]
        count = whole.shape[0] if numbers is None else len(numbers)
        self.shape = (count, instants[1] - instants[0], whole.shape[2])
        self.dtype = whole.dtype

    def __getitem__(self, place: Any) -> Any:
        """By paths and instants."""
        paths, instants = place
        start, stop, step = instants.indices(self.shape[1])
        instants = slice(self._first + start, self._first + stop, step)
        if self._numbers is None:
            return self._whole[paths, instants]
        if not isinstance(paths, slice):
            return self._whole[int(self._numbers[paths]), instants]
        rows = [self._whole[int(number), instants] for number in self._numbers[paths]]
        return np.stack(rows) if rows else np.empty((0, stop - start, self.shape[2]))


class InFile:
    """Samples of which parts are read as they are asked for: (paths, T), time first or not, and
    eight or nine components, or three by three.
    """

    ndim = 3

    def __init__(self, data: Any, time_first: bool) -> None:
        self._data, self._time_first = data, time_first
        n, m = data.shape[:2]
        width = 9 if data.ndim == 4 else data.shape[2]
        self.shape = (m, n, width) if time_first else (n, m, width)
        self.dtype, self._factor = data.dtype, 1.0

    def times(self, factor: float) -> InFile:
        """The same, times a number."""
        found = InFile(self._data, self._time_first)
        found._factor = self._factor * factor
        return found

    def __getitem__(self, place: Any) -> Any:
        """By paths and instants."""
        paths, instants = place
        part = self._data[instants, paths] if self._time_first else self._data[paths, instants]
        if self._data.ndim == 4:
            part = part.reshape(*part.shape[:-2], 9)
        if self._time_first and part.ndim == 3:
            part = np.swapaxes(part, 0, 1)
        return self._factor * part


class InRows:
    """Samples of paths that follow one another in a file, each from a row of its own on.

    data (rows, components), or (rows, 3, 3); starts (paths,); count: of samples taken of each.
    """

    ndim = 3

    def __init__(self, data: Any, starts: Integers, count: int, factor: float = 1.0):
        self._data, self._starts, self._factor = data, starts, factor
        self.shape = len(starts), count, 9 if data.ndim == 3 else data.shape[1]
        self.dtype = data.dtype

    def times(self, factor: float) -> InRows:
        """The same, times a number."""
        return InRows(self._data, self._starts, self.shape[1], self._factor * factor)

    def __getitem__(self, place: Any) -> Any:
        """By paths and instants."""
        paths, instants = place
        starts = np.atleast_1d(self._starts[paths])
        inside = np.arange(*instants.indices(self.shape[1]))
        if not len(starts) or not len(inside):
            return np.empty((len(starts), len(inside), self.shape[2]))
        first, last = int(starts.min()), int(starts.max())
        block = self._data[first + inside[0] : last + inside[-1] + 1]
        found = block.reshape(len(block), -1)[(starts - first)[:, None] + inside - inside[0]]
        return self._factor * (found if isinstance(paths, slice) else found[0])
