"""Where a result goes: asked of the file system by rank 0, before anything is computed."""

from __future__ import annotations

from pathlib import Path

from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import CaseError
from qbxstokes.io.names import check_writable
from qbxstokes.io.store import free_name


def result_path(loaded: LoadedCase) -> Path:
    """The result file that the case asks for."""
    return Path(loaded.case.output.file or f"{loaded.path.stem}.h5")


def target_of(loaded: LoadedCase, overwrite: bool = False) -> Path:
    """The file that will be written: the one asked for, or the next free name.

    Raises CaseError where it cannot be written.
    """
    output = result_path(loaded)
    overwrite = overwrite or loaded.case.output.overwrite
    try:
        check_writable(output, overwrite)
    except CaseError as error:
        raise loaded.error("output.file", str(error)) from None
    return output if overwrite else free_name(output)
