"""Of several runs that would write at one place, one holds the lock of its working folder."""

import fcntl
import os
import time
from pathlib import Path

from qbxstokes.errors import CaseError, OutputError

LOCK = "lock"


def locked(folder: Path) -> int:
    """A descriptor that holds the folder's lock, the folder being made where it is not there."""
    while True:
        try:
            folder.mkdir(exist_ok=True)
            descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
        except FileNotFoundError:  # its owner has just removed it
            continue
        except OSError as error:
            raise OutputError(
                f"{folder}: cannot be made ({error.strerror or error}); choose another output.file"
            ) from None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            who = _owner(descriptor)
            os.close(descriptor)
            raise CaseError(
                f"{folder}: another run is writing here{f' ({who})' if who else ''}; wait for it, "
                "or choose another output.file"
            ) from None
        except OSError:  # a file system without locks: two runs at once cannot be told apart
            pass
        try:
            if os.stat(folder / LOCK).st_ino == os.fstat(descriptor).st_ino:
                break
        except FileNotFoundError:
            pass
        os.close(descriptor)  # the folder was removed, and perhaps made anew, in between
    os.ftruncate(descriptor, 0)
    os.write(descriptor, f"process {os.getpid()} on {os.uname().nodename}\n".encode())
    return descriptor


def _owner(descriptor: int) -> str:
    """Who holds a lock: whoever has just taken it may not have written its name yet."""
    until = time.monotonic() + 1.0
    while not (who := os.pread(descriptor, 200, 0)) and time.monotonic() < until:
        time.sleep(0.01)
    return who.decode(errors="replace").strip()
