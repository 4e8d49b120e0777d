"""What belongs to each lane of a block, or is shared by all: bodies, and free motions of lanes.

Hydrodynamics that are not a law with coefficients are asked for the motion itself.
"""

import math
from collections.abc import Callable, Hashable, Iterator, Sequence
from functools import partial
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

import numpy as np

from qbxstokes.bie.functional import BodyModel
from qbxstokes.motion import fore_aft
from qbxstokes.typing import Array, Indices

# The kernels of each class of laws (`bie.functional.FaxenCoefficients.symmetry`): a module with
# `pack_body`, `unpack_body`, `N_NUMBERS`, `ROWS`, `free`, `driven_motion`, `accelerations`,
# `massless`, `inertial` and `for_compiler`.
KERNELS: dict[str, Any] = {"fore-aft revolution": fore_aft}

T = TypeVar("T")


class PerLane(Generic[T]):
    """One thing for all lanes, or a sequence with one for each.

    Equal things, by `key`, are kept once; where all are equal they are `shared`. Raises ValueError
    for a sequence that is not as long as there are lanes.
    """

    def __init__(self, given: T | Sequence[T], n_lanes: int, key: Callable[[T], Hashable]) -> None:
        self._lanes: Indices | None = None
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

    Rows are whole blocks one after the other: row i is of lane i modulo the number of lanes. It
    finds force and torque directly, too, where all providers do.
    """

    def __init__(self, providers: PerLane[Any], n_lanes: int) -> None:
        self._groups = list(providers.groups())
        self._n_lanes = n_lanes
        if all(isinstance(entry, ForceTorque) for entry in providers.distinct):
            self.force_torque = partial(self._asked, "force_torque")

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


def provider_of(providers: PerLane[FreeMotion], n_lanes: int) -> FreeMotion:
    """One provider for all lanes."""
    return providers.only if providers.shared else LaneMotions(providers, n_lanes)


class Bodies:
    """What the equations need of the body models.

    driven: whether anything follows from the resistance, which may be missing otherwise. Columns
    are one, of what is shared, or one for each lane. Raises ValueError for bodies whose laws are of
    different classes, or that are driven and were formed without the resistance.
    """

    def __init__(self, model: BodyModel | Sequence[BodyModel], n_lanes: int, driven: bool) -> None:
        self.models: PerLane[BodyModel] = PerLane(model, n_lanes, _key)
        kinds = {entry.faxen.symmetry for entry in self.models.distinct}
        if len(kinds) > 1:
            raise ValueError(f"laws of one block must be of one class, not {sorted(kinds)}")
        self.kernels = KERNELS[kinds.pop()]
        self.table = self.models.table(lambda entry: self.kernels.pack_body(entry, driven))
        # Plain numbers, or a row of each for the lanes.
        numbers = self.table.tolist() if self.models.shared else list(self.table)
        self.law, self.mobility, self.gyration = self.kernels.unpack_body(numbers)
        self.resistance = self._columns(lambda entry: _resistance(entry, driven))
        self.inertia = self._columns(_inertia)
        # Of the spheroids whose axes move alike, (1,) or (n_lanes,).
        self.effective_ratio: Array = self._columns(lambda entry: [entry.effective_ratio])[0]

    def _columns(self, numbers: Any) -> Array:
        table = self.models.table(numbers)
        return table[:, None] if table.ndim == 1 else table


def _key(model: BodyModel) -> Any:
    """What tells apart the bodies of a block."""
    law = model.faxen
    drag = None if model.formed_resistance is None else tuple(_resistance(model, True))
    numbers = law.linear, law.rest, *law.quadratic, *law.cubic, law.rest_of_second
    return law.symmetry, model.shape, drag, numbers


def _resistance(model: BodyModel, driven: bool) -> list[float]:
    """Translation transverse and axial, rotation transverse and axial."""
    return list(vars(model.resistance).values()) if driven else [math.nan] * 4


def _inertia(model: BodyModel) -> list[float]:
    """Volume and moments of inertia, in the order of the resistance."""
    volume, (j1, _, j3) = model.shape.volume, model.shape.inertia.tolist()
    return [volume, volume, j1, j3]
