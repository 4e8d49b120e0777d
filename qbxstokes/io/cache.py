"""Operators and functionals on disk, kept between runs.

One entry is one file (`io.store`) named after the hash of its key. The key holds everything that
determines the arrays: body, scheme, what was solved, and a fingerprint of the sources that compute
them; so an entry never has to be invalidated, only found or not. Entries appear whole or not at
all, whatever other ranks and processes do. An entry is not believed: one that cannot be read, that
holds another key than its name promises, that others than its user could have written, or whose
arrays fail the check of whoever asks for them, is told in `problems` and counts as missing.
"""

import hashlib
import json
import os
import stat
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from qbxstokes.folders import default_folder
from qbxstokes.io.store import DamagedPart, read_part, write_part
from qbxstokes.typing import AnyArray

Arrays = Mapping[str, AnyArray]
FORMAT_VERSION = 2
# Packages whose sources determine the arrays.
_NUMERICAL = ("geometry", "qbx", "bie")
_KEY = "key"


@cache
def fingerprint() -> str:
    """Hash of what computes the arrays: a changed formula finds no old entry.

    The version of NumPy is part of it, since the next one may round differently.
    """
    root = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256(np.__version__.encode())
    for package in _NUMERICAL:
        for path in sorted((root / package).glob("*.py")):
            digest.update(path.name.encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


class Cache:
    """Entries in one folder; with `folder` None nothing is found there and nothing kept.

    problems: one line for each entry that was damaged or could not be written. found, stored:
    counts. entries: what was loaded or stored, if it is `shared` with other ranks.
    """

    def __init__(self, folder: Path | None, shared: bool = False) -> None:
        self.folder = folder
        self.entries: dict[str, dict[str, AnyArray]] | None = {} if shared else None
        self.problems: list[str] = []
        self.found = 0
        self.stored = 0

    def load(
        self, kind: str, key: Mapping[str, Any], fault: Callable[[Arrays], str] = lambda _: ""
    ) -> dict[str, AnyArray] | None:
        """The arrays kept under this key, None if there are none or they are not to be used.

        fault: says what is wrong with the arrays, '' where nothing is; it may fail on wrong ones.
        """
        if self.folder is None and self.entries is None:
            return None
        text = _text(kind, key)
        if self.entries is not None and text in self.entries:
            return dict(self.entries[text])
        if self.folder is None:
            return None
        path = self._path(kind, text)
        try:
            arrays, note = _own_part(path)
            wrong = fault(arrays)
            if note.get(_KEY) != text:
                wrong = "not the entry that its name promises"
        except FileNotFoundError:
            return None
        except (OSError, DamagedPart) as error:
            wrong = f"unreadable ({error})"
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            wrong = f"does not hold a {kind} ({' '.join(str(error).split())})"
        if wrong:
            self.problems.append(f"{path}: {wrong}; computed anew")
            return None
        self.found += 1
        if self.entries is not None:
            self.entries[text] = arrays
        return dict(arrays)

    def store(self, kind: str, key: Mapping[str, Any], arrays: Mapping[str, AnyArray]) -> None:
        """Keep the arrays under this key; a folder that cannot be written is told, no more."""
        if self.folder is None and self.entries is None:
            return
        text = _text(kind, key)
        if self.entries is not None:
            self.entries[text] = dict(arrays)
        if self.folder is None:
            return
        path = self._path(kind, text)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_part(path, arrays, {_KEY: text})
            self.stored += 1
        except OSError as error:
            self.problems.append(f"{path}: not written ({error.strerror or error})")

    def _path(self, kind: str, text: str) -> Path:
        assert self.folder is not None
        return self.folder / f"{kind}-{hashlib.sha256(text.encode()).hexdigest()[:32]}.h5"


def _own_part(path: Path) -> tuple[dict[str, AnyArray], dict[str, Any]]:
    """What a file holds that its user alone could have written; raises DamagedPart, OSError."""
    told = os.lstat(path)
    if not stat.S_ISREG(told.st_mode):
        raise DamagedPart("not a file")
    if hasattr(os, "geteuid") and told.st_uid != os.geteuid():
        raise DamagedPart("it belongs to another user")
    if told.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise DamagedPart("others may write it")
    return read_part(path)


def open_cache(named: str | None, off: bool = False) -> Cache:
    """The cache of a run: a named folder, else that of QBXSTOKES_CACHE or of the user."""
    return Cache(None if off else Path(named).expanduser() if named else default_folder())


def _text(kind: str, key: Mapping[str, Any]) -> str:
    """The key as text: floats by their shortest exact form, keys in order."""
    whole = {"format": FORMAT_VERSION, "sources": fingerprint(), "kind": kind, **key}
    return json.dumps(whole, sort_keys=True, allow_nan=False)
