"""What a sweep is of, and what its result holds: columns, quantities, scales."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from qbxstokes.case.load import LoadedCase
from qbxstokes.case.sweep import column_name
from qbxstokes.case.values import Key
from qbxstokes.io.sweep_result import REASON_LENGTH, Layout
from qbxstokes.quantities import BODY_COLUMNS, COUPLED_COLUMNS, PARAMETER, STATUS
from qbxstokes.quantity import Quantity
from qbxstokes.runs.plan import MotionPlan, plan_body, plan_coupled
from qbxstokes.typing import AnyArray, Array, Integers

_COORDINATE_PIECE = 65_536
# Vectors of every body that shares a fluid, of `task: body` where something drives them.
DRIVEN = ("free_velocity", "free_angular_velocity", "held_force", "held_torque")


@dataclass(frozen=True)
class Block:
    """Trajectories integrated together: pieces of one scene or of several."""

    number: int
    pieces: tuple[tuple[int, Integers], ...]

    @property
    def index(self) -> Integers:
        """Numbers of all its trajectories, piece after piece."""
        return np.concatenate([index for _, index in self.pieces])


class Swept:
    """What a sweep is of: `size` scenes in `blocks`, and what its result says of them.

    samples: of each; common_times: their instants (T,), None where scenes have their own.
    quantities: stored at every instant; columns: of the table after the swept values. skips: what
    is left out and why, as far as the first tells for all. sharing: bodies that share the fluid, 0
    for one alone. alone: whether each scene is computed by itself; turns: how many times it is.
    """

    nouns = "scene", "scenes"
    alone, turns, sharing, block_size, samples = True, 1, 0, 1, 0
    common_times: Array | None = None
    quantities: tuple[str, ...] = ()
    columns: dict[str, Quantity]
    skips: tuple[str, ...]

    def __init__(self, loaded: LoadedCase) -> None:
        assert loaded.space is not None
        self.loaded, self.space = loaded, loaded.space
        self.size = self.blocks = self.space.size

    def block(self, number: int) -> Block:
        """A block by its number."""
        return Block(number, ((number, np.array([number])),))

    def block_sizes(self) -> Integers:
        """Trajectories, or scenes, per block."""
        return np.ones(self.size, dtype=np.int64)

    # -- what the result holds ----------------------------------------------------------------

    @cached_property
    def layout(self) -> Layout:
        """What the result file holds."""
        coordinates = self._coordinate_types()
        columns: list[tuple[str, Any]] = [*coordinates.items()]
        columns += [("status", "i1"), *((name, "f8") for name in self.columns)]
        columns += [("reason", f"S{REASON_LENGTH}")]
        swept = {
            name: PARAMETER.get(name) or Quantity(name, "", "", f"swept value {name}")
            for name in coordinates
        }
        return Layout(
            self.space.size,
            self.samples,
            np.dtype(columns),
            self.quantities,
            self.common_times,
            tuple(coordinates),
            {**swept, **STATUS, **self.columns},
            self.sharing,
        )

    def _coordinate_types(self) -> dict[str, Any]:
        """Columns of the swept values and their types; vectors one column per component."""
        types: dict[str, Any] = {}
        for _, column in self.space.columns:
            if column.numeric:
                sample = column.take(np.arange(min(column.size, 1)))
                types |= dict.fromkeys(_columns(column.key, sample), "f8")
            else:
                assert column.values is not None
                words = [_word(value) for value in column.values.tolist()]
                types[column_name(column.key)] = f"S{max(1, *(len(word) for word in words))}"
        return types

    def coordinates(self, index: AnyArray) -> dict[str, AnyArray]:
        """Swept values of some trajectories as columns."""
        columns: dict[str, AnyArray] = {}
        numeric = {column.key: column.numeric for _, column in self.space.columns}
        for key, values in self.space.values(index).items():
            plain = values if numeric[key] else np.array([_word(word) for word in values.tolist()])
            columns |= _columns(key, plain)
        return columns

    def scales(self) -> Iterator[tuple[int, dict[str, AnyArray]]]:
        """The scales of the file in pieces."""
        layout = self.layout
        for first in range(0, layout.size, _COORDINATE_PIECE):
            index = np.arange(first, min(first + _COORDINATE_PIECE, layout.size))
            columns = self.coordinates(index)
            typed = {name: values.astype(layout.dtype[name]) for name, values in columns.items()}
            yield first, {"trajectory": index, **typed}
        if layout.quantities and layout.times is not None:
            yield 0, {"time": layout.times}
        elif layout.quantities:
            yield 0, {"sample": np.arange(layout.samples)}


def _columns(key: Key, values: AnyArray) -> dict[str, AnyArray]:
    """Values (n,) of a key as a column, vectors as one per component; quaternions from 0 on."""
    name = column_name(key)
    if values.ndim == 1:
        return {name: values}
    first = 0 if values.shape[1] == 4 else 1
    return {f"{name}_{i + first}": values[:, i] for i in range(values.shape[1])}


def _word(value: Any) -> bytes:
    text = value if isinstance(value, str) else json.dumps(value)
    return text.encode("ascii", "backslashreplace")


class BodyScenes(Swept):
    """All bodies of a sweep."""

    nouns = "body", "bodies"

    def __init__(self, loaded: LoadedCase) -> None:
        super().__init__(loaded)
        measure = loaded.case.sweep.measure
        self.turns = 1 if measure is None else 1 + measure.repeats
        # Without a flow a body neither moves nor has to be held.
        moving = loaded.case.flow is not None
        self.columns = {
            name: about
            for name, about in BODY_COLUMNS.items()
            if moving or not name.startswith(("free_", "held_"))
        }
        self.skips = plan_body(loaded).skips


class CoupledScenes(Swept):
    """All scenes of a sweep over several bodies or a wall."""

    def __init__(self, loaded: LoadedCase) -> None:
        super().__init__(loaded)
        if loaded.case.sweep.measure is not None:
            wrong = "has no meaning with a wall or several bodies"
            raise loaded.error("sweep.measure", wrong, "leave it out")
        self.first = plan = plan_coupled(loaded)
        self.skips = plan.skips
        self.sharing = len(loaded.case.members) if loaded.case.bodies is not None else 0
        moving = loaded.case.task == "motion"
        self.columns = dict(COUPLED_COLUMNS)
        for name in ("final_position", "final_axis") if moving else DRIVEN:
            told = f"{name.replace('_', ' ')}: body, component"
            for column in columns_of_bodies(name, self.sharing):
                self.columns[column] = Quantity(column, "", "", told)
        if isinstance(plan, MotionPlan):
            self.nouns, self.samples = ("trajectory", "trajectories"), len(plan.times)
            if loaded.case.sweep.store == "samples":
                self.quantities = plan.quantities
            if not any(column.key[0] == "time" for _, column in self.space.columns):
                self.common_times = plan.times


def columns_of_bodies(name: str, bodies: int) -> list[str]:
    """Columns of a vector of every body: free_velocity_2_1 of the second; without, of one."""
    numbers = [f"_{body + 1}" for body in range(bodies)] or [""]
    return [f"{name}{number}_{part}" for number in numbers for part in (1, 2, 3)]
