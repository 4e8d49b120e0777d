"""A sweep of `task: body`: every point is a body, a scene and a block of its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from qbxstokes.case.load import LoadedCase
from qbxstokes.quantities import BODY_COLUMNS
from qbxstokes.runs.plan import plan_body
from qbxstokes.runs.scenes import Block, Scenes

Indices = NDArray[np.int64]


class BodyScenes:
    """All bodies of a sweep, each computed alone: what `Scenes` says of motions, of them."""

    nouns = "body", "bodies"
    alone, block_size, samples = True, 1, 0
    common_times: None = None
    quantities: tuple[str, ...] = ()

    def __init__(self, loaded: LoadedCase) -> None:
        assert loaded.space is not None
        assert loaded.case.sweep is not None
        self.loaded, self.space = loaded, loaded.space
        measure = loaded.case.sweep.measure
        self.turns = 1 if measure is None else 1 + measure.repeats
        self.size = self.blocks = self.space.size
        # Without a flow a body neither moves nor has to be held.
        moving = loaded.case.flow is not None
        self.columns = {
            name: about
            for name, about in BODY_COLUMNS.items()
            if moving or not name.startswith(("free_", "held_"))
        }

    def block(self, number: int) -> Block:
        """A block by its number."""
        return Block(number, ((number, np.array([number])),))

    def block_sizes(self) -> Indices:
        """Bodies per block."""
        return np.ones(self.size, dtype=np.int64)

    @property
    def skips(self) -> tuple[str, ...]:
        """What is left out and why, as far as the first body tells for all."""
        return plan_body(self.loaded).skips


Swept = Scenes | BodyScenes


def swept_scenes(loaded: LoadedCase) -> Swept:
    """The scenes of a sweep: of motions, or of bodies."""
    if loaded.case.task == "body":
        return BodyScenes(loaded)
    return Scenes(loaded)
