"""Set-up spread over the ranks: each forms its share of the rows of the layer potentials.

Rows are independent, so that any number of ranks gives the numbers of one. Rank 0 runs the set-up
and asks for rows when it needs them (not at all where the cache has the result); the other ranks
wait for its orders without occupying their cores.
"""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from qbxstokes.errors import QbxStokesError
from qbxstokes.petsc.launch import finish_asleep
from qbxstokes.qbx.operator import layer_rows

T = TypeVar("T")


class Alone:
    """Stands for the communicator of a single rank."""

    rank, size = 0, 1


ALONE = Alone()


class RowTeam:
    """The ranks of a communicator at the service of rank 0, above all as one former of rows.

    `dismiss` ends their service.
    """

    def __init__(self, comm: Any, services: Mapping[str, Callable[..., Any]] | None = None) -> None:
        """services: what the other ranks can do together with rank 0, by name (see `join`)."""
        self._comm, self._services = comm, services or {}
        self._serving = comm.size > 1

    def __call__(
        self, shape: Any, scheme: Any, n_modes: int, rows: Any, with_single: bool = False
    ) -> tuple[Any, Any]:
        """Rows as `layer_rows` gives them, formed by all ranks; for rank 0."""
        order = (shape, scheme, n_modes, list(rows), with_single)
        if not self._serving:
            return layer_rows(*order)
        ordered(self._comm, ("rows", order))
        return _put_together(self._comm.gather(_share(order, 0, self._comm.size)))

    def serve(self) -> None:
        """Form rows for rank 0, and join in services, until dismissed; for the other ranks."""
        while (order := ordered(self._comm)) is not None:
            name, arguments = order
            if name == "rows":
                self._comm.gather(_share(arguments, self._comm.rank, self._comm.size))
            else:
                self._services[name](*arguments)

    def join(self, name: str, *arguments: Any) -> Any:
        """Have the other ranks begin a service, in which rank 0 then takes part itself.

        Returns the communicator of those who take part.
        """
        if not self._serving:
            return ALONE
        ordered(self._comm, (name, arguments))
        return self._comm

    def dismiss(self) -> None:
        """Let the other ranks go on; rank 0 forms further rows alone."""
        if self._serving:
            self._serving = False
            ordered(self._comm)


def ordered(comm: Any, order: Any = None, pause: float = 2e-3) -> Any:
    """The order of rank 0 on every rank; pause: between looks of the others, who sleep."""
    arrived = comm.Ibarrier()
    if comm.rank:
        finish_asleep(arrived, pause)
    else:
        arrived.Wait()
    return comm.bcast(order)


def _share(order: Any, rank: int, size: int) -> tuple[Any, Any]:
    """A rank's share of an order: every `size`-th row, so that dear rows are dealt out evenly."""
    shape, scheme, n_modes, rows, *single = order
    return layer_rows(shape, scheme, n_modes, rows[rank::size], *single)


def _put_together(parts: list[tuple[Any, Any]]) -> tuple[Any, Any]:
    """The shares of all ranks as one."""
    double, single = (np.concatenate(shares) for shares in zip(*parts, strict=True))
    for rank, (first, second) in enumerate(parts):
        double[rank :: len(parts)] = first
        single[rank :: len(parts)] = second
    return double, single


def rows_by_all(comm: Any, *order: Any) -> tuple[Any, Any]:
    """Rows as `layer_rows` gives them, formed by all ranks and known to all; called by all."""
    share = _share(order, comm.rank, comm.size)
    return share if comm.size == 1 else _put_together(comm.allgather(share))


def with_team(
    comm: Any,
    action: Callable[[RowTeam], T],
    services: Mapping[str, Callable[..., Any]] | None = None,
) -> Callable[[], T]:
    """The action of rank 0 with the other ranks at its service; they have served on return.

    Every rank calls this; the result is to be run on rank 0 (`parallel.on_root`). A failure that
    all ranks share, in a service, ends the service of the others.
    """
    team = RowTeam(comm, services)
    if comm.rank:
        try:
            team.serve()
        except QbxStokesError as error:
            if not error.on_all_ranks:
                raise

    def run() -> T:
        shared = False
        try:
            return action(team)
        except QbxStokesError as error:
            shared = error.on_all_ranks
            raise
        finally:
            if not shared:
                team.dismiss()

    return run
