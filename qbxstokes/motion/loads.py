"""What acts on the bodies besides the flow: loads, and parts of the motion that are prescribed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import SceneError
from qbxstokes.geometry import rotation
from qbxstokes.typing import Array

Vectors = ArrayLike | Callable[[float], ArrayLike]


@dataclass(frozen=True)
class Loads:
    """External force and torque on the bodies: arrays (3,) or (n_lanes, 3), or functions of time.

    force and torque are given in the space frame; body_force and body_torque in the body frame,
    in which they stay fixed. Units mu c^2/tau and mu c^3/tau.
    """

    force: Vectors = (0.0, 0.0, 0.0)
    torque: Vectors = (0.0, 0.0, 0.0)
    body_force: Vectors = (0.0, 0.0, 0.0)
    body_torque: Vectors = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _require_vectors(vars(self))

    @property
    def in_order(self) -> tuple[Vectors, Vectors, Vectors, Vectors]:
        """In the order of the kernels: force in space and body frame, torque in both."""
        return self.force, self.body_force, self.torque, self.body_torque

    def repeated(self, count: int) -> Loads:
        """The loads of `count` times the same lanes."""
        return Loads(*(_tiled(vectors, count) for vectors in vars(self).values()))


@dataclass(frozen=True)
class Constraints:
    """Prescribed parts of the motion, None where it is free.

    velocity and angular_velocity are given in the space frame as arrays (3,) or (n_lanes, 3) or
    functions of time; zero locks. For St > 0 the prescribed part of the state keeps its initial
    value and is not read.
    """

    velocity: Vectors | None = None
    angular_velocity: Vectors | None = None

    def __post_init__(self) -> None:
        _require_vectors(vars(self))

    @classmethod
    def held(cls) -> Constraints:
        """Neither translates nor rotates."""
        return cls(velocity=(0.0, 0.0, 0.0), angular_velocity=(0.0, 0.0, 0.0))

    @property
    def free(self) -> bool:
        """Whether nothing is prescribed."""
        return self.velocity is None and self.angular_velocity is None

    @property
    def steady(self) -> bool:
        """Whether nothing prescribed is a function of time."""
        return not (callable(self.velocity) or callable(self.angular_velocity))

    def repeated(self, count: int) -> Constraints:
        """The constraints of `count` times the same lanes."""
        return Constraints(_tiled(self.velocity, count), _tiled(self.angular_velocity, count))


def _require_vectors(given: Mapping[str, Any]) -> None:
    """Raise SceneError where what is given by name is neither None, a function nor (..., 3)."""
    for name, vectors in given.items():
        if vectors is not None and not callable(vectors) and np.shape(vectors)[-1:] != (3,):
            raise SceneError(name, f"has shape {np.shape(vectors)}", "three numbers, or (..., 3)")


def _tiled(vectors: Any, count: int) -> Any:
    if vectors is None or callable(vectors) or np.ndim(vectors) < 2:
        return vectors
    return np.tile(vectors, (count, 1))


class LoadRows:
    """The loads of a block as the kernels take them: (12, columns), see `drag.driven_motion`."""

    def __init__(self, loads: Loads, columns: int) -> None:
        self.rows: Array = np.zeros((12, columns))
        self._timed: list[tuple[int, Callable[[float], ArrayLike]]] = []
        for place, vectors in enumerate(loads.in_order):
            if callable(vectors):
                self._timed.append((place, vectors))
            else:
                self._fill(place, vectors)

    @property
    def steady(self) -> bool:
        """Whether no load is a function of time."""
        return not self._timed

    @property
    def push(self) -> bool:
        """Whether there is a force, or one that is a function of time."""
        return any(place < 2 for place, _ in self._timed) or bool(np.any(self.rows[:6]))

    def at(self, t: float) -> Array:
        """The rows at a time, which the next call overwrites."""
        for place, vectors in self._timed:
            self._fill(place, vectors(t))
        return self.rows

    def in_space(self, t: float, q: Array) -> tuple[Array, Array]:
        """Force and torque (columns, 3) in space at a time, on bodies of orientations q."""
        force, own_force, torque, own_torque = self.at(t).reshape(4, 3, -1).swapaxes(1, 2)
        return force + rotation.to_space(q, own_force), torque + rotation.to_space(q, own_torque)

    def _fill(self, place: int, vectors: ArrayLike) -> None:
        values = np.asarray(vectors, dtype=np.float64)
        rows = values.T if values.ndim == 2 else values[:, None]
        self.rows[3 * place : 3 * place + 3] = rows
