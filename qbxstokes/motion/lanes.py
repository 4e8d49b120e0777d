"""What belongs to each lane of a block, or is shared by all of them."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
T = TypeVar("T")


class PerLane(Generic[T]):
    """One thing for all lanes, or a sequence with one for each.

    Equal things, by `key`, are kept once; where all are equal they are `shared`. Raises ValueError
    for a sequence that is not as long as there are lanes.
    """

    def __init__(self, given: T | Sequence[T], n_lanes: int, key: Callable[[T], Hashable]) -> None:
        self._lanes: NDArray[np.intp] | None = None
        if not isinstance(given, list | tuple):
            self.distinct: tuple[T, ...] = (given,)  # type: ignore[assignment]
            return
        if len(given) != n_lanes:
            raise ValueError(f"{len(given)} entries for {n_lanes} lanes")
        # Lanes often repeat one object, whose key need not be found again.
        known = {id(entry): entry for entry in given}
        places: dict[Hashable, int] = {}
        place = {name: places.setdefault(key(entry), len(places)) for name, entry in known.items()}
        first = {place[name]: entry for name, entry in reversed(known.items())}
        self.distinct = tuple(first[i] for i in range(len(places)))
        if not self.shared:
            self._lanes = np.array([place[id(entry)] for entry in given], dtype=np.intp)

    @property
    def shared(self) -> bool:
        """Whether all lanes have the same."""
        return len(self.distinct) == 1

    @property
    def only(self) -> T:
        """What all lanes share. Raises ValueError where they differ."""
        if not self.shared:
            raise ValueError("the lanes differ in it")
        return self.distinct[0]

    def table(self, numbers: Callable[[T], Any]) -> Array:
        """The numbers (m,) of what is shared, or those of each lane as columns, (m, n_lanes)."""
        columns = [np.asarray(numbers(entry), dtype=np.float64) for entry in self.distinct]
        if self._lanes is None:
            return columns[0]
        return np.ascontiguousarray(np.stack(columns, axis=-1)[:, self._lanes])

    def groups(self) -> Iterator[tuple[T, Any]]:
        """Each distinct thing with an index of its lanes."""
        for place, entry in enumerate(self.distinct):
            yield (
                entry,
                slice(None) if self._lanes is None else np.flatnonzero(self._lanes == place),
            )

    def repeated(self, count: int) -> T | list[T]:
        """What makes the same of `count` times the lanes."""
        if self._lanes is None:
            return self.distinct[0]
        return [self.distinct[place] for place in self._lanes] * count
