"""Section `study`: physical and numerical studies, each a set of blocks, tables and a figure."""

from __future__ import annotations

from qbxstokes.case.tabulate import Tables


class Study(Tables):
    """Studies of `task: study`, named in `tables`; blocks are shared among the ranks."""
