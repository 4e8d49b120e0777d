"""Set-up spread over the ranks: each forms its share of the rows of the layer potentials.

Rows are independent, so that any number of ranks gives the numbers of one. Rank 0 runs the set-up
and asks for rows when it needs them (not at all where the cache has the result); the other ranks
wait for its orders without occupying their cores.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.qbx.operator import Scheme, layer_rows

T = TypeVar("T")

_POLL = 2e-3  # seconds between looks of a waiting rank


class RowTeam:
    """The ranks of a communicator as one former of rows; `dismiss` ends the others' service."""

    def __init__(self, comm: Any) -> None:
        self._comm = comm
        self._serving = comm.size > 1

    def __call__(
        self,
        spheroid: Spheroid,
        scheme: Scheme,
        n_modes: int,
        rows: Sequence[int],
        with_single: bool = False,
    ) -> tuple[Any, Any]:
        """Rows as `layer_rows` gives them, formed by all ranks; for rank 0."""
        order = (spheroid, scheme, n_modes, list(rows), with_single)
        if not self._serving:
            return layer_rows(*order)
        self._order(order)
        parts = self._comm.gather(_share(order, 0, self._comm.size))
        double = np.empty((len(rows), *parts[0][0].shape[1:]))
        single = np.empty((len(rows), *parts[0][1].shape[1:]))
        for rank, (some_double, some_single) in enumerate(parts):
            double[rank :: self._comm.size] = some_double
            single[rank :: self._comm.size] = some_single
        return double, single

    def serve(self) -> None:
        """Form rows for rank 0 until it dismisses the team; for the other ranks."""
        while (order := self._order(None)) is not None:
            self._comm.gather(_share(order, self._comm.rank, self._comm.size))

    def dismiss(self) -> None:
        """Let the other ranks go on; rank 0 forms further rows alone."""
        if self._serving:
            self._serving = False
            self._order(None)

    def _order(self, order: Any) -> Any:
        if self._comm.rank:
            arrived = self._comm.Ibarrier()
            while not arrived.Test():
                time.sleep(_POLL)
        else:
            self._comm.Ibarrier().Wait()
        return self._comm.bcast(order)


def _share(order: Any, rank: int, size: int) -> tuple[Any, Any]:
    """A rank's share of an order: every `size`-th row, so that dear rows are dealt out evenly."""
    spheroid, scheme, n_modes, rows, with_single = order
    return layer_rows(spheroid, scheme, n_modes, rows[rank::size], with_single)


def with_team(comm: Any, action: Callable[[RowTeam], T]) -> Callable[[], T]:
    """The action of rank 0 with the other ranks at its service; they have served on return.

    Every rank calls this; the result is to be run on rank 0 (`parallel.on_root`).
    """
    team = RowTeam(comm)
    if comm.rank:
        team.serve()

    def run() -> T:
        try:
            return action(team)
        finally:
            team.dismiss()

    return run
