"""Tables of numbers in files, read in one way wherever the program takes one.

A text file holds one row a line: its entries are separated by commas, semicolons, tabs or blanks,
whichever its first row shows; empty lines and what follows a # are left out, a byte order mark and
quotes too. A first row in which not every entry is a number names the columns. A .npy file holds
the array itself and is mapped, not read.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qbxstokes.errors import CaseError
from qbxstokes.typing import AnyArray

HDF5 = ".h5", ".hdf5", ".nc", ".nc4"
_TEXT = 2**30  # bytes of text that are read
SEPARATORS = ";", "\t", ","


class TableError(CaseError):
    """A file is no table of numbers: which file, which line and column, and what is wrong."""


@dataclass(frozen=True)
class Table:
    """Rows of a file: `names` of the columns, () if it has none.

    numbers: (rows, columns). words: the entries as they stand where some are no numbers, which only
    `words=True` lets through; `numbers` is then empty. lines: the line of each row, from 1.
    """

    path: Path
    names: tuple[str, ...]
    numbers: AnyArray
    words: list[list[str]] | None
    lines: list[int]


def read_table(path: str | Path, columns: int | None = None, *, words: bool = False) -> Table:
    """The table that a file holds; raises TableError.

    columns: how many there have to be. words: entries may be other than numbers.
    """
    path = Path(path)
    check_file(path)
    try:
        if path.suffix == ".npy":
            return _mapped(path, columns)
        text = path.read_text("utf-8-sig")
    except OSError as error:
        raise TableError(f"{path}: cannot be read ({error.strerror or error})") from None
    except ValueError as error:
        raise TableError(f"{path}: is no table ({error})") from None
    whole = [line.partition("#")[0].strip(" \r") for line in text.split("\n")]
    lines = [number for number, line in enumerate(whole, 1) if line.strip()]
    rows = [whole[number - 1] for number in lines]
    if not rows:
        raise TableError(f"{path}: holds no rows")
    separator = next((mark for mark in SEPARATORS if mark in rows[0]), None)
    if separator is None and len(rows[0].split()) == 1:
        separator = SEPARATORS[0]  # one column: words such as '10 deg' may hold blanks
    first = _split(rows[0], separator)
    names: tuple[str, ...] = ()
    if not all(map(_is_number, first)):
        names, rows, lines = tuple(first), rows[1:], lines[1:]
        if not rows:
            raise TableError(f"{path}: holds no rows below its header")
    width = len(names) or columns or len(first)
    if columns is not None and (len(names) or len(first)) != columns:
        found = len(names) or len(first)
        raise TableError(f"{path}: line {lines[0]} has {found} columns; {columns} are expected")
    try:
        numbers = np.loadtxt(rows, delimiter=separator, ndmin=2, comments=None)
        if numbers.shape[1] == width and np.isfinite(numbers).all():
            return Table(path, names, numbers, None, lines)
    except ValueError:
        pass
    entries = [_split(row, separator) for row in rows]
    for line, row in zip(lines, entries, strict=True):
        if len(row) != width:
            raise TableError(f"{path}: line {line} has {len(row)} entries; {width} are expected")
        for place, entry in enumerate(row, 1):
            if not (words or _is_number(entry)):
                raise TableError(f"{path}: line {line}, column {place}: {fault(entry)}")
    if words and not all(_is_number(entry) for row in entries for entry in row):
        return Table(path, names, np.empty((0, width)), entries, lines)
    return Table(path, names, np.array(entries, dtype=np.float64), None, lines)


def _mapped(path: Path, columns: int | None) -> Table:
    numbers = np.load(path, mmap_mode="r", allow_pickle=False)
    names: tuple[str, ...] = numbers.dtype.names or ()
    if names and numbers.ndim == 1 and all(numbers.dtype[n].kind in "fiu" for n in names):
        numbers = np.stack([numbers[name] for name in names], axis=1)
    if numbers.dtype.kind not in "fiu" or numbers.ndim != 2:
        wrong = f"holds {numbers.dtype} of shape {numbers.shape}"
        raise TableError(f"{path}: {wrong}; rows and columns of numbers are expected")
    if not len(numbers):
        raise TableError(f"{path}: holds no rows")
    if columns is not None and numbers.shape[1] != columns:
        raise TableError(f"{path}: has {numbers.shape[1]} columns; {columns} are expected")
    return Table(path, names, numbers, None, [])


def _split(row: str, separator: str | None) -> list[str]:
    if separator is None:
        return row.split()
    reader = csv.reader([row], delimiter=separator, skipinitialspace=True)
    return [entry.strip() for entry in next(reader)]


def _is_number(entry: str) -> bool:
    try:
        return bool(np.isfinite(float(entry)))
    except ValueError:
        return False


def fault(entry: str) -> str:
    """Why an entry is no number."""
    if not entry:
        return "is empty; a number is expected"
    point = entry.replace(",", ".")
    if point != entry and _is_number(point):
        return f"{entry!r} is no number; write a point for the comma: {point}"
    shown = entry if len(entry) <= 40 else entry[:37] + "..."
    return f"{shown!r} is no finite number"


def check_file(path: Path) -> None:
    """Raise TableError for what is there but no file, or too long to be read as text."""
    if path.exists() and not path.is_file():  # reading might wait, or go on, for ever
        raise TableError(f"{path}: is a folder, pipe or device; a file is expected")
    if path.suffix not in (".npy", *HDF5) and path.is_file() and path.stat().st_size > _TEXT:
        size = path.stat().st_size / 1e9
        raise TableError(f"{path}: is {size:.1f} GB of text; a .npy file is mapped, not read")


def read_datasets(path: str | Path) -> dict[str, AnyArray]:
    """Finite numbers (N, ...) of all datasets of an HDF5 file, by name; raises TableError."""
    import h5py

    check_file(Path(path))
    try:
        with h5py.File(path) as file:
            found = {name: np.asarray(file[name][()], dtype=np.float64) for name in file}
    except (OSError, TypeError, ValueError) as error:
        raise TableError(f"{path}: cannot be read ({error})") from None
    if not found or len({values.shape[:1] for values in found.values()} - {()}) != 1:
        raise TableError(f"{path}: has no datasets of one length")
    for name, values in found.items():
        if not values.ndim or not np.isfinite(values).all():
            raise TableError(f"{path}: {name} is no row of finite numbers")
    return found
