"""The manual: pages in Markdown beside the package, each a topic, printed as plain text."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from qbxstokes.errors import CaseError

PAGES = Path(__file__).parents[1] / "pages"


def topics() -> dict[str, str]:
    """What each topic is about, by its name: the heading of its page."""
    found = {}
    for path in sorted(PAGES.glob("*.md")):
        with path.open(encoding="utf-8") as stream:
            found[path.stem] = stream.readline().lstrip("# ").strip()
    return found


def contents() -> str:
    """The topics, one a line."""
    found = topics()
    width = max(map(len, found))
    lines = [f"  {name:{width}}  {heading}" for name, heading in found.items()]
    return "\n".join(["usage: python -m qbxstokes help TOPIC", "", *lines]) + "\n"


def page(topic: str) -> str:
    """The page of a topic as plain text.

    Raises CaseError that names the nearest topic.
    """
    found = topics()
    if topic not in found:
        import difflib

        close = difflib.get_close_matches(topic.lower().removesuffix(".md"), found, 1, 0.4)
        right = f"did you mean {close[0]}?" if close else "python -m qbxstokes help lists them"
        raise CaseError(f"command line: help {topic}: no such topic; {right}")
    text = (PAGES / f"{topic}.md").read_text(encoding="utf-8")
    return "\n".join(_plain(text.splitlines())) + "\n"


def _plain(lines: list[str]) -> Iterator[str]:
    """Lines of Markdown without its marks: code indented, tables aligned, links their text."""
    code, table = False, []
    for line in [*lines, ""]:
        if not code and line.startswith("|"):
            table.append([cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]])
            continue
        yield from _aligned(table)
        table = []
        if line.startswith("```"):
            code = not code
        elif code:
            yield f"    {line}".rstrip()
        else:
            yield re.sub(r"\[([^\]]+)\]\([^)]+\)", r"\1", line)


def _aligned(table: list[list[str]]) -> Iterator[str]:
    """Rows of a table in columns."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for number, row in enumerate(table):
        cells = ["-" * w for w in widths] if number == 1 else row
        yield "  ".join(f"{cell:{w}}" for cell, w in zip(cells, widths, strict=True)).rstrip()
