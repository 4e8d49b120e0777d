"""The manual: pages in Markdown beside the package, each a topic, printed as plain text."""

import re
import textwrap
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path

from qbxstokes.errors import CaseError, nearest

PAGES = Path(__file__).parents[1] / "pages"
_WIDTH = 92  # of tables, in columns


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
    head = [
        "usage: python -m qbxstokes help TOPIC, one of these; begin with running",
        "       python -m qbxstokes --help, the commands and options",
    ]
    return "\n".join([*head, "", *lines]) + "\n"


def page(topic: str) -> str:
    """The page of a topic as plain text.

    Raises CaseError that names the nearest topic.
    """
    found = topics()
    if topic not in found:
        known = "python -m qbxstokes help lists them"
        right = nearest(topic.removesuffix(".md"), found, known)
        raise CaseError(f"command line: help {topic}: no such topic; {right}")
    text = (PAGES / f"{topic}.md").read_text(encoding="utf-8")
    return "\n".join(_plain(text.splitlines())) + "\n"


def _plain(lines: list[str]) -> Iterator[str]:
    """Lines of Markdown without its marks: code indented, tables aligned, links their text."""
    code, table = False, list[list[str]]()
    for line in [*lines, "```"]:
        text = line if code else re.sub(r"\[([^\]]+)\]\([^)]+\)", r"\1", line)
        if not code and line.startswith("|"):
            table.append([cell.strip() for cell in re.split(r"(?<!\\)\|", text)[1:-1]])
            continue
        yield from _aligned(table)
        table = []
        if line.startswith("```"):
            code = not code
        else:
            yield f"    {text}".rstrip() if code else text


def _aligned(table: list[list[str]]) -> Iterator[str]:
    """Rows of a table in columns; where they are too wide together, the widest are wrapped."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    while sum(widths) > _WIDTH - 2 * len(widths):
        widths[widths.index(max(widths))] -= 1
    for number, row in enumerate(table):
        cells = ["-" * width for width in widths] if number == 1 else row
        wrapped = [
            textwrap.wrap(*pair, break_on_hyphens=False) for pair in zip(cells, widths, strict=True)
        ]
        for line in zip_longest(*wrapped, fillvalue=""):
            padded = (f"{text:{width}}" for text, width in zip(line, widths, strict=True))
            yield "  ".join(padded).rstrip()
