"""Files that can be read, and folders in which something is kept from run to run, if it can be.

In a container or on a compute node it may not: the package is not writable, HOME is absent, `/`, or
full. Nothing that is kept is needed; what cannot be kept is made anew and told.
"""

import os
import stat
import sys
import tempfile
from functools import cache
from pathlib import Path

ENVIRONMENT = "QBXSTOKES_CACHE"
# What the compiled functions of a run take, several times over.
_ROOM = 2**24
# Lines for the user on what is not kept.
problems: list[str] = []


def default_folder() -> Path | None:
    """The user's cache folder; QBXSTOKES_CACHE names another, or none if it is empty.

    XDG Base Directory Specification on Unix, ~/Library/Caches on macOS, LOCALAPPDATA on Windows.
    """
    named = os.environ.get(ENVIRONMENT)
    try:
        if named is not None:
            return Path(named).expanduser() if named else None
        home = Path.home()
    except RuntimeError:
        return None
    if sys.platform == "darwin":
        base = home / "Library" / "Caches"
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    else:
        named = os.environ.get("XDG_CACHE_HOME", "")
        # The specification has relative paths ignored.
        base = Path(named) if os.path.isabs(named) else home / ".cache"
    return base / "qbxstokes"


def unreadable(path: Path, wanted: str) -> str:
    """Why a path is no file to be read, and that `wanted` is to be named; '' where it is one."""
    try:
        if path.is_dir():
            wrong = "is a directory"
        elif not path.exists():
            wrong = "no such file"
        elif not path.is_file():  # reading might wait, or go on, for ever
            wrong = "is a pipe or device"
        else:
            return "" if os.access(path, os.R_OK) else "no permission to read it"
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    return f"{wrong}; name {wanted}"


def unwritable(folder: Path) -> str:
    """Why nothing can be kept in a folder, which is made if need be; '' where it can."""
    try:
        folder.mkdir(0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, _ROOM)
    except OSError as error:
        return f"{folder}: cannot be written ({error.strerror or error})"
    return ""


def folder_of_compiled() -> tuple[Path | None, str]:
    """Where numba keeps compiled functions, None if nowhere, and why not there.

    NUMBA_CACHE_DIR, else beside the sources as numba does, else below the program's own folder:
    what is kept there is run, so nobody else may write it.
    """
    if named := os.environ.get("NUMBA_CACHE_DIR"):
        told = unwritable(Path(named))
        return (None, told) if told else (Path(named), "")
    beside = Path(__file__).parent / "motion" / "__pycache__"
    if not (told := unwritable(beside)):
        return beside.parents[1], ""
    own = default_folder()
    if own is None:
        return None, told
    own /= "compiled"
    if told := unwritable(own):
        return None, told
    status = own.stat()
    others = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    if hasattr(os, "geteuid") and (status.st_uid != os.geteuid() or others):
        return None, f"{own}: not to be trusted (it belongs to, or may be written by, others)"
    return own, ""


@cache
def compiled_are_kept() -> bool:
    """For `numba.njit(cache=...)`: whether there is a folder for them, which numba is told."""
    folder, told = folder_of_compiled()
    if folder is None:
        problems.append(f"{told}; functions are compiled anew in each run (some seconds)")
    elif folder != Path(__file__).parent:
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
        if "numba" in sys.modules:
            sys.modules["numba"].config.CACHE_DIR = str(folder)
    if "numba" in sys.modules:
        _spare_linear_algebra()
    return folder is not None


def _spare_linear_algebra() -> None:
    """Let numba take BLAS for granted where SciPy is.

    It looks by importing all of SciPy's linear algebra, a twentieth of a short run, and does so
    again where a function needs it. Where numba is made in another way it looks for itself.
    """
    looked_for = "scipy.linalg.cython_blas"
    if looked_for in sys.modules or "numba.np.arraymath" in sys.modules:
        return
    sys.modules[looked_for] = None  # type: ignore[assignment]
    try:
        from numba.np import arraymath
    except ImportError:
        return
    finally:
        del sys.modules[looked_for]
    arraymath._HAVE_BLAS = "scipy" in sys.modules
