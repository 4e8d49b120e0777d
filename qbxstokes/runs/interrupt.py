"""SIGINT and SIGTERM during a run: asked to stop once, it stops at its next step."""

from __future__ import annotations

import signal
from pathlib import Path
from types import FrameType
from typing import Any

from qbxstokes.errors import Interrupted

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interruption:
    """Within it the first signal is noted, and a second one stops the process at once.

    listening: whether anybody looks at `asked`; until then the first signal stops at once, too.
    patient: the process waits for another one (rank 0), which decides.
    """

    def __init__(self, patient: bool = False) -> None:
        self.signal = 0
        self.listening = False
        self.patient = patient
        self._former: dict[int, Any] = {}

    def asked(self) -> bool:
        """Whether a signal has come."""
        return self.signal != 0

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.patient:
            return
        if self.signal or not self.listening:
            raise KeyboardInterrupt
        self.signal = number

    def __enter__(self) -> Interruption:
        """Take over both signals."""
        self._former = {number: signal.signal(number, self._note) for number in _SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        """Give them back."""
        for number, handler in self._former.items():
            signal.signal(number, handler)


def interrupted(folder: Path, number: int) -> Interrupted:
    """What to tell when the signal `number` has stopped a run that keeps finished blocks."""
    return Interrupted(
        f"interrupted; finished blocks are kept in {folder}: go on with --resume", number
    )
