"""The bodies of a block: the numbers of each lane, or those that all share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from qbxstokes.bie.functional import BodyModel
from qbxstokes.motion.kernels import KERNELS
from qbxstokes.motion.lanes import PerLane
from qbxstokes.typing import Array


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
