"""Names of result files: free ones, numbered ones, a case's newest, those that can be written."""

import contextlib
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from qbxstokes.errors import CaseError, HeldFileError, ResultFileError
from qbxstokes.io.format import FORMAT, open_file, stored_text


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
    if overwrite and os.path.lexists(path):
        with contextlib.suppress(OSError):
            if path.is_file():
                with open_file(path) as file:
                    if file.attrs.get("format") == FORMAT:
                        return
        raise CaseError(
            f"{path}: exists and is not a result of this program, so it is not overwritten; "
            "choose another name or remove it"
        )


def temporary_name(path: Path, folder: Path | None = None) -> Path:
    """The name under which a result is written until it is complete, beside it or in a folder."""
    return (folder or path.parent) / f".{path.name}.{os.getpid()}.part"


def told_by(path: Path, name: str, complete: bool = False) -> str | None:
    """An attribute of a result's provenance, None where there is none.

    complete: of a result that is whole alone.
    """
    if not path.exists():
        return None
    try:
        with open_file(path) as file:
            if complete and not file["summary"].attrs["complete"]:
                return None
            held = file["provenance"]
            return str(held.attrs[name] if name in held.attrs else held[name].asstr()[()])
    except (OSError, KeyError, HeldFileError):
        return None


def newest(path: str | Path) -> Path:
    """The result that a name stands for: of a case file its newest result in the working folder.

    Raises ResultFileError where a case has no result here.
    """
    path = Path(path)
    if path.suffix not in (".yaml", ".yml"):
        return path
    found = _results_of(path.name, Path().glob("*.h5"))
    if not found:
        with contextlib.suppress(OSError):
            open_file(path.with_suffix(".h5").name).close()  # HeldFileError, if it is one's own
        raise ResultFileError(f"{path}: has no result here; run the case, or name its result file")
    return found[-1]


def newer(path: Path) -> Path | None:
    """A later run's result of the same case, result-1.h5 beside result.h5; None without."""
    case = told_by(path, "case_file")
    stem = re.escape(re.sub(r"-\d+$", "", path.stem))
    like = re.compile(rf"{stem}(-\d+)?{re.escape(path.suffix)}")
    beside = (other for other in path.parent.iterdir() if like.fullmatch(other.name))
    found = _results_of(Path(case).name, beside) if case else []
    return found[-1] if found and _written(found[-1]) > _written(path) else None


def older_pictures(path: Path) -> list[Path]:
    """Pictures in the working folder that are named after a result and older than it."""
    stem = re.escape(path.stem)
    named = re.compile(rf"({stem}(?:-\d+)?)(?:-[A-Za-z][\w-]*)?\.(?:pdf|svg|png|gif|mp4)")
    found = {picture: named.fullmatch(picture.name) for picture in Path().iterdir()}
    return sorted(
        picture
        for picture, match in found.items()
        if match and _written(picture) < _written(path)  # and not of a result-1.h5
        if match[1] == path.stem or not path.with_name(match[1] + path.suffix).exists()
    )


def _written(path: Path) -> int:
    return path.stat().st_mtime_ns


def _results_of(case: str, paths: Iterable[Path]) -> list[Path]:
    """Those that are results of a case by its file's name, the newest last."""
    case = stored_text(case)
    found = [path for path in paths if Path(told_by(path, "case_file") or "").name == case]
    return sorted(found, key=_written)
