"""Tables: named columns with units and meaning, rows, notes, and how they were made.

Every table of the program (benchmarks, stress tests, studies, sweeps) is a `Table`. It prints as
aligned text or Markdown, and is kept as CSV or in an HDF5 file, from both of which it is read back
unchanged.

In HDF5 a table is a group `/tables/NAME` with one dataset per column, attributes `unit`,
`description` and `format` on each, and attributes `title`, `notes`, `plot`, `provenance` on the
group. In CSV the same stands in lines that start with `#` before the header, so that
`pandas.read_csv(file, comment="#")` reads the rows.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.errors import CaseError, ResultFileError

if TYPE_CHECKING:
    import h5py
    import pandas

GROUP = "tables"
_CSV_MARK = "# qbxstokes table, version 1"
_FOLDED = 12  # a text is not folded narrower than this to keep a table in one piece
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")

Value = str | bool | int | float | None


@dataclass(frozen=True)
class Column:
    """A column: its name (an identifier), unit, meaning, and how its numbers are printed.

    unit: "" for a pure number. format: a format specification such as ".2e" or "d"; without one,
    numbers are printed to three digits. heading: what stands above the printed column instead of
    the name.
    """

    name: str
    unit: str = ""
    description: str = ""
    format: str = ""
    heading: str = ""

    def __post_init__(self) -> None:
        """Refuse a name that is no identifier, with ValueError."""
        if not _NAME.match(self.name):
            raise ValueError(f"column name {self.name!r} is not an identifier")

    @property
    def words(self) -> list[str]:
        """The heading as words."""
        return (self.heading or self.name.replace("_", " ")).split()


@dataclass
class Table:
    """Rows of values under described columns.

    name: an identifier. title: one line. notes: sentences below the table. provenance: what made
    it (machine, command, version). plot: how it is best drawn, for example
    {"x": "bodies", "y": ["time"], "by": "method", "scale": "loglog"}. A missing value is None.

    >>> table = Table("squares", "Squares", (Column("n"), Column("n2", description="n times n")))
    >>> table.add(n=3, n2=9)
    >>> table["n2"].tolist()
    [9]
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: list[tuple[Value, ...]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    provenance: dict[str, str] = field(default_factory=dict)
    plot: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check names and the length of the rows, with ValueError."""
        self.columns = tuple(self.columns)
        self.title = _one_line(self.title)
        if not _NAME.match(self.name):
            raise ValueError(f"table name {self.name!r} is not an identifier")
        names = [column.name for column in self.columns]
        if len(set(names)) != len(names) or not names:
            raise ValueError(f"table {self.name} needs columns with different names: {names}")
        self.rows = [self._checked(row) for row in self.rows]

    # -- content ----------------------------------------------------------------------------

    def _checked(self, row: Sequence[Any]) -> tuple[Value, ...]:
        if len(row) != len(self.columns):
            raise ValueError(
                f"table {self.name} has {len(self.columns)} columns, a row has {len(row)} values"
            )
        return tuple(_simple(value) for value in row)

    def add(self, **values: Any) -> None:
        """Append a row by column names; a column that is not given is missing in it."""
        unknown = set(values) - set(self.names)
        if unknown:
            raise ValueError(f"table {self.name} has no column {', '.join(sorted(unknown))}")
        self.rows.append(self._checked([values.get(name) for name in self.names]))

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return [column.name for column in self.columns]

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.rows)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """The column `name` as an array: bool, int, float (missing: nan) or text (missing: '')."""
        if name not in self.names:
            raise KeyError(f"no column {name}; there are {', '.join(self.names)}")
        index = self.names.index(name)
        return _array([row[index] for row in self.rows])

    def column(self, name: str) -> Column:
        """The description of the column `name`."""
        return self.columns[self.names.index(name)]

    def records(self) -> Iterator[dict[str, Value]]:
        """Each row as a dictionary."""
        for row in self.rows:
            yield dict(zip(self.names, row, strict=True))

    def to_pandas(self) -> pandas.DataFrame:
        """The rows as a DataFrame, everything else in its `attrs`; needs pandas."""
        import pandas as pd

        frame = pd.DataFrame({name: self[name] for name in self.names})
        frame.attrs = {"name": self.name, "title": self.title, **self.provenance}
        return frame

    # -- printing ---------------------------------------------------------------------------

    def cells(self) -> list[list[str]]:
        """The rows as text, each number in the format of its column."""
        return [
            [_cell(value, column.format) for value, column in zip(row, self.columns, strict=True)]
            for row in self.rows
        ]

    def to_text(self, width: int = 80) -> str:
        """Aligned text at most `width` wide: title, headings over units, rows, notes.

        Headings are stacked word by word. A table that is still too wide goes on below, with its
        first column repeated; a text that alone is too wide is folded.
        """
        cells = self.cells()
        blocks = [self.title]
        for indices in self._parts(cells, width):
            blocks.append(self._block(cells, indices, width))
        for note in self.notes:
            blocks.append(textwrap.fill(note, width, subsequent_indent="  "))
        for key, value in self.provenance.items():
            blocks.append(
                textwrap.fill(
                    f"{key}: {value}", width, subsequent_indent="  ", break_on_hyphens=False
                )
            )
        return "\n".join(blocks)

    def _heads(self) -> list[list[str]]:
        """Lines of each column's heading, the unit last, all of the same number of lines."""
        stacked = [_stack(column.words) for column in self.columns]
        tallest = max(len(lines) for lines in stacked)
        units = [f"[{column.unit}]" if column.unit else "" for column in self.columns]
        heads = [
            [""] * (tallest - len(lines)) + lines + [unit]
            for lines, unit in zip(stacked, units, strict=True)
        ]
        return heads if any(units) else [head[:-1] for head in heads]

    def _widths(self, cells: list[list[str]]) -> list[int]:
        heads = self._heads()
        return [
            max(len(text) for text in (*heads[index], *(row[index] for row in cells)))
            for index in range(len(self.columns))
        ]

    def _parts(self, cells: list[list[str]], width: int) -> list[list[int]]:
        """Columns of each part of the printed table."""
        widths = self._widths(cells)
        parts: list[list[int]] = [[0]]
        used = widths[0]
        for index in range(1, len(self.columns)):
            needed = 2 + widths[index]
            if index == len(self.columns) - 1 and self._folds(index):
                needed = 2 + min(widths[index], max(_FOLDED, width - used - 2))
            if used + needed > width and len(parts[-1]) > 1:
                parts.append([0])
                used = widths[0]
            parts[-1].append(index)
            used += needed
        return parts

    def _folds(self, index: int) -> bool:
        """Whether the column holds texts, which can be folded."""
        return not _is_numeric(self[self.columns[index].name])

    def _block(self, cells: list[list[str]], indices: list[int], width: int) -> str:
        widths = self._widths(cells)
        numeric = [_is_numeric(self[column.name]) for column in self.columns]
        excess = sum(widths[i] for i in indices) + 2 * (len(indices) - 1) - width
        if excess > 0:  # fold the last column if that helps, or the widest text
            texts = [i for i in indices if not numeric[i]]
            if texts:
                last = indices[-1]
                enough = last in texts and widths[last] - excess >= _FOLDED
                folded = last if enough else max(texts, key=lambda i: widths[i])
                widths[folded] = max(8, widths[folded] - excess)
        heads = self._heads()

        def line(texts: Sequence[str]) -> str:
            return "  ".join(
                text.rjust(widths[i]) if numeric[i] else text.ljust(widths[i])
                for i, text in zip(indices, texts, strict=True)
            ).rstrip()

        lines = [line([heads[i][j] for i in indices]) for j in range(len(heads[0]))]
        lines.append(line(["-" * widths[i] for i in indices]))
        for row in cells:
            entries = [
                textwrap.wrap(row[i], widths[i]) or [""] if not numeric[i] else [row[i]]
                for i in indices
            ]
            for j in range(max(len(parts) for parts in entries)):
                lines.append(line([parts[j] if j < len(parts) else "" for parts in entries]))
        return "\n".join(lines)

    def to_markdown(self) -> str:
        """A Markdown table, aligned in its source too, with notes and provenance below it."""
        cells = [[text.replace("|", "\\|") for text in row] for row in self.cells()]
        heads = [
            " ".join(column.words) + (f" [{column.unit}]" if column.unit else "")
            for column in self.columns
        ]
        numeric = [_is_numeric(self[column.name]) for column in self.columns]
        widths = [
            max(4, len(head), *(len(row[index]) for row in cells), 0)
            for index, head in enumerate(heads)
        ]

        def line(texts: Sequence[str]) -> str:
            return (
                "| "
                + " | ".join(
                    text.rjust(width) if right else text.ljust(width)
                    for text, width, right in zip(texts, widths, numeric, strict=True)
                )
                + " |"
            )

        rule = [
            "-" * (width - 1) + (":" if right else "-")
            for width, right in zip(widths, numeric, strict=True)
        ]
        lines = [f"**{self.title}**", "", line(heads), line(rule), *map(line, cells)]
        for note in self.notes:
            lines += ["", note]
        if self.provenance:
            lines += ["", "; ".join(f"{key}: `{value}`" for key, value in self.provenance.items())]
        return "\n".join(lines)

    # -- files ------------------------------------------------------------------------------

    def to_csv(self) -> str:
        """The whole table as CSV text; numbers to their last digit."""
        stream = io.StringIO()
        kinds = self._kinds()
        header = {
            "name": self.name,
            "title": self.title,
            "notes": self.notes,
            "provenance": self.provenance,
            "plot": self.plot,
        }
        print(_CSV_MARK, file=stream)
        for key, value in header.items():
            print(f"# {key}: {json.dumps(value)}", file=stream)
        for column, kind in zip(self.columns, kinds, strict=True):
            print(f"# column: {json.dumps({**vars(column), 'kind': kind})}", file=stream)
        writer = csv.writer(stream, lineterminator="\n", quoting=csv.QUOTE_MINIMAL)
        writer.writerow(self.names)
        for row in self.rows:
            entries = zip(row, kinds, strict=True)
            writer.writerow(
                ["" if value is None else _written(value, kind) for value, kind in entries]
            )
        return stream.getvalue()

    def write_csv(self, path: str | Path) -> Path:
        """Write the CSV file, replacing it only when complete; raises CaseError if impossible."""
        path = Path(path)
        temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            temporary.write_text(self.to_csv(), encoding="utf-8")
            os.replace(temporary, path)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            raise CaseError(f"{path}: cannot be written ({error.strerror})") from None
        return path

    @classmethod
    def from_csv(cls, text: str, name: str = "table.csv") -> Table:
        """The table of a text that `to_csv` made; raises ResultFileError for anything else."""
        lines = list(io.StringIO(text))
        if not lines or lines[0].rstrip("\r\n") != _CSV_MARK:
            raise ResultFileError(f"{name}: is not a table written by this program")
        header: dict[str, Any] = {}
        columns: list[dict[str, Any]] = []
        try:
            end = 1
            while end < len(lines) and lines[end].startswith("# "):
                key, _, value = lines[end][2:].partition(": ")
                if key == "column":
                    columns.append(json.loads(value))
                else:
                    header[key] = json.loads(value)
                end += 1
            kinds = [column.pop("kind") for column in columns]
            table = cls(columns=tuple(Column(**column) for column in columns), **header)
            reader = csv.reader(lines[end:])
            if next(reader) != table.names:
                raise ValueError("its header does not name its columns")
            for row in reader:
                read = zip(row, kinds, strict=True)
                table.rows.append(table._checked([_read(entry, kind) for entry, kind in read]))
        except (ValueError, TypeError, KeyError, StopIteration, csv.Error) as error:
            raise ResultFileError(f"{name}: is a damaged table ({error})") from None
        return table

    @classmethod
    def read_csv(cls, path: str | Path) -> Table:
        """Read a CSV file; raises ResultFileError if it is missing, damaged or not ours."""
        try:
            text = Path(path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "not UTF-8 text"
            raise ResultFileError(f"{path}: cannot be read ({reason})") from None
        return cls.from_csv(text, str(path))

    def write_hdf5(self, file: h5py.Group) -> None:
        """Store the table in `/tables/NAME` of an open HDF5 file."""
        if GROUP not in file:
            file.create_group(GROUP, track_order=True)
        group = file[GROUP].create_group(self.name, track_order=True)
        group.attrs["title"] = self.title
        group.attrs["notes"] = json.dumps(self.notes)
        group.attrs["provenance"] = json.dumps(self.provenance)
        group.attrs["plot"] = json.dumps(self.plot)
        for column, kind in zip(self.columns, self._kinds(), strict=True):
            values = self[column.name]
            data = values.tolist() if kind == "text" else values
            options: dict[str, Any] = {"track_times": False}
            if kind == "text":
                import h5py

                options |= {"dtype": h5py.string_dtype(), "shape": (len(data),)}
            dataset = group.create_dataset(column.name, data=data, **options)
            described = {key: value for key, value in vars(column).items() if key != "name"}
            dataset.attrs.update({**described, "kind": kind})

    @classmethod
    def from_hdf5(cls, group: h5py.Group) -> Table:
        """The table of a group that `write_hdf5` made."""
        columns, values = [], []
        for name, dataset in group.items():
            attributes = {
                key: str(dataset.attrs[key]) for key in ("unit", "description", "format", "heading")
            }
            columns.append(Column(name, **attributes))
            text = dataset.attrs["kind"] == "text"
            entries = dataset.asstr()[()] if text else dataset[()]
            values.append([_missing(entry) for entry in entries.tolist()])
        return cls(
            name=group.name.rpartition("/")[2],
            title=str(group.attrs["title"]),
            columns=tuple(columns),
            rows=list(zip(*values, strict=True)),
            notes=json.loads(group.attrs["notes"]),
            provenance=json.loads(group.attrs["provenance"]),
            plot=json.loads(group.attrs["plot"]),
        )

    def _kinds(self) -> list[str]:
        """'text', 'bool', 'int' or 'float' of every column."""
        letters = {"U": "text", "b": "bool", "i": "int", "f": "float"}
        return [letters[self[name].dtype.kind] for name in self.names]


def read_tables(file: h5py.Group) -> dict[str, Table]:
    """The tables of an open result file by name, in the order in which they were written."""
    if GROUP not in file:
        return {}
    return {name: Table.from_hdf5(group) for name, group in file[GROUP].items()}


def _simple(value: Any) -> Value:
    """`value` as plain Python, texts on one line; NaN and '' count as missing.

    Raises ValueError for anything but a text, a truth value or a number.
    """
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str):
        return _one_line(value) or None
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        return float(value)
    if value is None or isinstance(value, int):
        return value
    if isinstance(value, float):
        return None if math.isnan(value) else value
    raise ValueError(f"a table holds texts and numbers, not {type(value).__name__}")


def _one_line(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)


def _missing(value: Any) -> Any:
    return None if value == "" else value


def _array(values: Sequence[Value]) -> NDArray[Any]:
    """An array of one type: bool, int, float or text, by what the values hold."""
    present = [value for value in values if value is not None]
    if any(isinstance(value, str) for value in present):
        return np.array(["" if value is None else str(value) for value in values], dtype=np.str_)
    whole = len(present) == len(values)
    if whole and values and all(isinstance(value, bool) for value in values):
        return np.array(values, dtype=np.bool_)
    if whole and values and all(isinstance(value, int) for value in values):
        return np.array(values, dtype=np.int64)
    return np.array([math.nan if v is None else float(v) for v in values], dtype=np.float64)


def _is_numeric(values: NDArray[Any]) -> bool:
    return values.dtype.kind in "if"


def _cell(value: Value, form: str) -> str:
    """A value as printed."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if isinstance(value, int):
        return format(value, form or "d")
    if form == "d" and value != int(value):
        form = ""
    return format(int(value) if form == "d" else value, form or ".3g")


def _stack(words: Sequence[str]) -> list[str]:
    """Words over each other, short ones side by side up to the longest."""
    longest = max([7, *(len(word) for word in words)])
    return textwrap.wrap(" ".join(words), longest) or [""]


def _written(value: Any, kind: str) -> str:
    """A value of a column of the given kind, to its last digit."""
    return repr(float(value)) if kind == "float" else str(value)


def _read(text: str, kind: str) -> Value:
    """The inverse of `_written`; '' is a missing value."""
    if text == "":
        return None
    if kind == "bool":
        return {"True": True, "False": False}[text]
    return {"int": int, "float": float, "text": str}[kind](text)
