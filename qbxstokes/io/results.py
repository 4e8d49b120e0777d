"""Result files, one HDF5 file per run, read back as NumPy arrays.

Layout of a motion (format_version 1): datasets `time` (T) and the quantities of a motion
(`quantities.MOTION`), each (T, ...) with attributes `units`, `description`, `frame` and `time` as
its dimension scale; groups `provenance` (how it was made) and `summary` (what came out);
attributes `format`, `format_version`, `task`, `conventions` at the root.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from qbxstokes.errors import ResultFileError
from qbxstokes.io.format import FORMAT, FORMAT_VERSION, read_tree
from qbxstokes.io.result import Result
from qbxstokes.io.sweep_result import read_sweep


def load(path: str | Path) -> Result:
    """Read a result file; raises ResultFileError if it is missing, damaged or not ours.

    >>> result = load("jeffery_prolate.h5")  # doctest: +SKIP
    >>> result.time.shape, result.axis.shape  # doctest: +SKIP
    ((301,), (301, 3))
    """
    import h5py

    path = Path(path)
    try:
        if path.is_dir():
            raise ResultFileError(f"{path}: is a directory; name a result file (.h5)")
        if not path.exists():
            raise ResultFileError(f"{path}: no such file; name a result file (.h5)")
        if not path.is_file():  # reading a pipe might wait for ever
            raise ResultFileError(f"{path}: is a pipe or device; name a result file (.h5)")
        if not os.access(path, os.R_OK):
            raise ResultFileError(f"{path}: no permission to read it")
    except OSError as error:
        raise ResultFileError(f"{path}: cannot be read ({error.strerror})") from None
    if not h5py.is_hdf5(path):
        raise ResultFileError(f"{path}: is not an HDF5 file; name a result of this program")
    try:
        with h5py.File(path, "r") as file:
            header = dict(file.attrs)
            if header.get("format") != FORMAT or "task" not in header:
                raise ResultFileError(f"{path}: an HDF5 file, but not written by this program")
            if int(header.get("format_version", 0)) > FORMAT_VERSION:
                raise ResultFileError(
                    f"{path}: has format version {header['format_version']}, this program reads "
                    f"{FORMAT_VERSION}; update qbxstokes"
                )
            if header["task"] == "sweep":
                return read_sweep(path, file, header)
            arrays: dict[str, NDArray[Any]] = {}
            attributes: dict[str, dict[str, Any]] = {}
            groups: dict[str, dict[str, Any]] = {}
            for name, item in file.items():
                if isinstance(item, h5py.Group):
                    groups[name] = read_tree(item)
                    continue
                arrays[name] = item[()]
                attributes[name] = {
                    key: item.attrs[key]
                    for key in ("units", "description", "frame", "components")
                    if key in item.attrs
                }
            if "summary" not in groups:
                raise ResultFileError(f"{path}: is incomplete: it has no summary; run it again")
    except ResultFileError:
        raise
    except Exception as error:  # h5py reports damage by errors of many kinds
        reason = " ".join(str(error).split())
        raise ResultFileError(f"{path}: is damaged or truncated ({reason})") from None
    return Result(path, header, arrays, attributes, groups)


def told_by(path: Path, name: str, complete: bool = False) -> str | None:
    """An attribute of a result's provenance, None where there is none.

    complete: of a result that is whole alone.
    """
    if not path.exists():
        return None
    import h5py

    try:
        with h5py.File(path, "r") as file:
            if complete and not file["summary"].attrs["complete"]:
                return None
            held = file["provenance"]
            return str(held.attrs[name] if name in held.attrs else held[name].asstr()[()])
    except (OSError, KeyError):
        return None
