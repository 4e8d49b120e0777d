"""Signals that ask a run to stop, those of a batch system too: asked once, it stops when it can."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from qbxstokes.errors import Interrupted

# What a person, a closing terminal, and a batch system before its limit send; those there are.
_SIGNALS = [
    getattr(signal, f"SIG{name}")
    for name in ("INT", "TERM", "HUP", "QUIT", "USR1", "USR2", "XCPU")
    if hasattr(signal, f"SIG{name}")
]


class Interruption:
    """Within it the first signal is noted, and a second one stops the process at once.

    listening: whether anybody looks at `asked`; until then the first signal stops at once, too.
    patient: the process waits for another one (rank 0), which decides. Outside the main thread,
    where Python takes no signals, nothing is noted.
    """

    def __init__(self) -> None:
        self.signal = 0
        self.listening = self.patient = False
        self._former: dict[int, Any] = {}

    def asked(self) -> bool:
        """Whether a signal has come."""
        return self.signal != 0

    @contextmanager
    def at_once(self, folder: Path) -> Iterator[None]:
        """Within it a signal stops at once what nobody looks after; the folder keeps the rest."""
        if self.signal:
            raise interrupted(folder, self.signal)
        listening, self.listening = self.listening, False
        try:
            yield
        except KeyboardInterrupt as stop:
            raise interrupted(folder, stop.args[0] if stop.args else signal.SIGINT) from None
        finally:
            self.listening = listening

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.patient:
            return
        if self.signal or not self.listening:
            raise KeyboardInterrupt(number)
        self.signal = number

    def take(self) -> None:
        """Take over the signals, once more where PETSc has taken some of them as it started."""
        if threading.current_thread() is not threading.main_thread():
            return
        for number in _SIGNALS:
            former = signal.signal(number, self._note)
            self._former.setdefault(number, former)

    def __enter__(self) -> Interruption:
        """Take over the signals."""
        self.take()
        return self

    def __exit__(self, *_: object) -> None:
        """Give them back; those whose handler Python does not know stay at their default."""
        for number, handler in self._former.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def interrupted(folder: Path, number: int) -> Interrupted:
    """What to tell when the signal `number` has stopped a run that keeps what is finished."""
    return Interrupted(
        f"{signal.Signals(number).name}: interrupted; what is finished is kept in {folder}: go on "
        "with --resume",
        number,
    )
