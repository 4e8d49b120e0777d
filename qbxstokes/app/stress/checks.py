"""A table of checks: what was tried, the worst that came out, the bound, and whether it held."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from qbxstokes.io.tables import Column, Table


class Checks:
    """Collects the worst value of every check, in the order in which they first appear.

    columns: descriptions of what identifies a check; their values are the arguments of `see`.
    """

    def __init__(self, name: str, title: str, columns: Sequence[Column], measured: str) -> None:
        self._table = Table(
            name,
            title,
            (
                *columns,
                Column("worst", "", measured, ".1e"),
                Column("bound", "", "what it must not exceed", ".0e"),
                Column("passed", "", "whether it does not"),
                Column("at", "", "where the worst value was met"),
            ),
        )
        self._worst: dict[tuple[Any, ...], tuple[float, float, str]] = {}

    def see(self, *key: Any, value: float, bound: float, at: str = "") -> None:
        """A value of the check `key`; the one that uses most of its bound is kept."""
        value, bound = float(value), float(bound)
        known = self._worst.get(key, (-1.0, bound, ""))
        if not math.isnan(known[0]) and not value / bound <= known[0] / known[1]:
            self._worst[key] = (value, bound, at)

    def note(self, text: str) -> None:
        """A sentence below the table."""
        self._table.notes.append(text)

    def table(self) -> Table:
        """The table of all checks; a value that is not a number fails.

        The last column is left out where no check told a place.
        """
        places = any(at for _, _, at in self._worst.values())
        if not places:
            self._table.columns = self._table.columns[:-1]
        names = self._table.names
        for key, (value, bound, at) in self._worst.items():
            shown = math.inf if math.isnan(value) else value
            row = [*key, shown, bound, value <= bound, *([at] if places else [])]
            self._table.add(**dict(zip(names, row, strict=True)))
        return self._table


def outcome(action: Callable[[], Any], *expected: type[BaseException]) -> tuple[Any, str]:
    """The result of an action and '', or None and the message with which it refused."""
    try:
        return action(), ""
    except expected as error:
        return None, str(error) or type(error).__name__
