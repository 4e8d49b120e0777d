"""Errors that end a run with one clear line instead of a traceback.

Every error a user can cause or meet derives from `QbxStokesError`; the command line prints its
message (what, where, what would be right) and leaves with `exit_status`.
"""

import sys
from collections.abc import Iterable
from importlib import import_module
from typing import Any


def escaped(text: str) -> str:
    """`text` on one line, with control and other unprintable characters as escape sequences."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def nearest(word: str, known: Iterable[str], otherwise: str, more: str = "") -> str:
    """The question for the known word that `word` most resembles, and more; or something else."""
    import difflib

    names = {name.lower(): name for name in known}
    close = difflib.get_close_matches(word.lower(), names, 1, 0.6) if word else []
    return f"did you mean {names[close[0]]}?{more}" if close else otherwise


class QbxStokesError(Exception):
    """Base class; a run that meets one ends with `exit_status` and the message alone."""

    exit_status = 1
    # Whether every rank raises it, so that one telling is enough and all leave by themselves.
    on_all_ranks = False

    def __str__(self) -> str:
        """The message on one printable line, whatever names and data it quotes."""
        return escaped(super().__str__())


class CaseError(QbxStokesError):
    """The input is wrong: a case file, a command line or a file named in them."""

    exit_status = 2


class SceneError(CaseError):
    """Something in a scene is wrong: `key` as in a case file, what is wrong, what would be right.

    A case file adds its name and line (`LoadedCase.pointed`).
    """

    def __init__(self, key: str, wrong: str, right: str = "") -> None:
        super().__init__(f"{key} {wrong}" + (f"; {right}" if right else ""))
        self.key, self.wrong, self.right = key, wrong, right


class MissingPackageError(CaseError, ModuleNotFoundError):
    """A library that only this needs is not installed."""


class SinglePrecisionWarning(UserWarning):
    """Numbers were rounded to single precision before; those taken instead satisfy what they must.

    On the command line it is one line on standard error.
    """


def needed(package: str, what: str, with_it: str = "") -> Any:
    """The library that `what` alone needs; raises MissingPackageError that says how to get it.

    with_it: what it needs besides.
    """
    try:
        return import_module(package)
    except ModuleNotFoundError:
        import shutil

        # Of the interpreter that runs, which need not be the one that `python` means.
        python = "python" if shutil.which("python") == sys.executable else sys.executable
        right = f"{python} -m pip install {package} {with_it}".rstrip()
        raise MissingPackageError(
            f"{what} needs {package}, which is not installed: {right}"
        ) from None


class FlowError(CaseError):
    """The background flow is ill specified, not Stokesian, or singular where the body is.

    `key` leads from the flow's specification to the entry at fault, where one is to blame.
    """

    def __init__(self, message: str, key: tuple[str | int, ...] = ()) -> None:
        super().__init__(message)
        self.key = key


class FlowFunctionError(FlowError):
    """A user's function for the flow raised an exception or returned no velocities."""


class ConvergenceError(QbxStokesError):
    """A solver or integrator stopped before it reached the tolerance that was asked for."""


class ContactError(QbxStokesError):
    """Bodies, or a body and the wall, touch or are nearer than the tolerance can be served."""

    def __init__(self, who: str, gap: float, why: str) -> None:
        super().__init__(f"{who}: the gap is {gap:.3g}; {why}")
        self.who, self.gap = who, gap


class Interrupted(QbxStokesError):
    """The run was stopped by a signal; the exit status is that of a shell, 128 + signal."""

    def __init__(self, message: str, signal: int) -> None:
        super().__init__(message, signal)
        self.message, self.exit_status = message, 128 + signal

    def __str__(self) -> str:
        """The message alone."""
        return self.message


class Stopping(QbxStokesError):
    """A signal asks the run to stop: what is under way is taken back to the last cut."""


class OutputError(QbxStokesError):
    """A result could not be written: the disk is full, say."""


class ResultFileError(CaseError):
    """A result file is missing, truncated, or was not written by this program."""


class HeldFileError(ResultFileError):
    """A result file that another program writes, or has open to write."""
