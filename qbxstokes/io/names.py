"""Names of result files: free ones, numbered ones, and whether one can be written."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from qbxstokes.errors import CaseError
from qbxstokes.io.format import FORMAT


def numbered(path: Path) -> Iterator[Path]:
    """result.h5, result-1.h5, result-2.h5, ..."""
    yield path
    for number in range(1, 1_000_000):
        yield path.with_name(f"{path.stem}-{number}{path.suffix}")


def parts_of(path: Path) -> Path:
    """The working folder of the run whose result is to be `path`."""
    return path.with_name(f"{path.name}.parts")


def check_writable(path: Path, overwrite: bool = False) -> None:
    """Refuse a target that cannot be written, before anything is computed; raises CaseError.

    overwrite: an existing file would be replaced, which only a result of this program may be.
    """
    folder = path.parent
    try:
        if path.is_dir():
            example = path / "result.h5"
            raise CaseError(f"{path}: is a directory; name a result file such as {example}")
        if not folder.is_dir():
            raise CaseError(
                f"{path}: there is no directory {folder}; create it or change output.file"
            )
        if not os.access(folder, os.W_OK | os.X_OK):
            raise CaseError(f"{path}: no permission to write in {folder.resolve()}; choose another")
        with contextlib.suppress(FileNotFoundError):
            os.lstat(temporary_name(path))  # complains about a name that is too long
    except OSError as error:
        raise CaseError(f"{path}: cannot be a result file ({error.strerror})") from None
    if overwrite and os.path.lexists(path) and not _is_result(path):
        raise CaseError(
            f"{path}: exists and is not a result of this program, so it is not overwritten; "
            "choose another name or remove it"
        )


def temporary_name(path: Path, folder: Path | None = None) -> Path:
    """The name under which a result is written until it is complete, beside it or in a folder."""
    return (folder or path.parent) / f".{path.name}.{os.getpid()}.part"


def _is_result(path: Path) -> bool:
    import h5py

    if not path.is_file():
        return False
    try:
        with h5py.File(path, "r") as file:
            return bool(file.attrs.get("format") == FORMAT)
    except OSError:
        return False
