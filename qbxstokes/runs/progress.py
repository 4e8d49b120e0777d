"""How far a long run is: a bar on a terminal, or whole lines at intervals; standard error, rank 0.

Lines are for files and for the output of several processes, which MPI mixes line by line.
"""

import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

from qbxstokes.petsc.session import stage
from qbxstokes.runs.report import duration

Style = Literal["auto", "bar", "line", "none"]

# A bar, of so many signs, is drawn again at most this often; a line at growing intervals, so that a
# log stays short.
_BAR_INTERVAL, _BAR = 0.1, 20
_LINE_INTERVALS = (2.0, 60.0)
_GROWTH = 1.3
# Seconds (s) between the first words of a motion.
_LONG = 10.0


class Progress:
    """Tells how many of `total` are done; `update` may be called as often as one likes."""

    def __init__(
        self,
        total: int,
        style: Style = "auto",
        ranks: int = 1,
        unit: str = "trajectories",
        before: int = 0,
    ) -> None:
        """before: how many were done when this run began."""
        if style == "auto":
            style = "bar" if ranks == 1 and sys.stderr.isatty() else "line"
        self._total, self._style, self._unit = total, style, unit
        self._begin = self._told = time.monotonic()
        self._interval = _LINE_INTERVALS[0] if style == "line" else _BAR_INTERVAL
        self._before, self._share = before, 0.0
        self._last: tuple[int, int] | None = None

    @property
    def due(self) -> bool:
        """Whether it is time to tell something new."""
        return self._style != "none" and time.monotonic() - self._told >= self._interval

    def update(self, done: int, failed: int = 0, share: float = 0.0) -> None:
        """Tell the state, if the last time is long enough ago.

        share: of the work that was to do at the start of this run, by what it costs.
        """
        self._share = share
        if self.due:
            self._tell(done, failed)

    def close(self, done: int, failed: int) -> None:
        """Tell the last state, where that is not what was told last."""
        if self._style != "none" and self._last != (done, failed):
            self._tell(done, failed)
        if self._style == "bar":
            print(file=sys.stderr)

    def _tell(self, done: int, failed: int) -> None:
        self._told, self._last = time.monotonic(), (done, failed)
        spent = self._told - self._begin
        finished = done + failed
        # Of this run alone: what an earlier one did says nothing of what is left.
        rate = (finished - self._before) / spent if spent > 0 else 0.0
        left = (self._total - finished) / rate if rate > 0 else float("inf")
        if self._share > 0.0:
            left = spent * (1.0 - self._share) / self._share
        parts = [f"{finished} of {self._total} {self._unit} ({finished / max(self._total, 1):.1%})"]
        if rate > 0:
            parts.append(f"{rate:.4g}/s")
        if finished < self._total:
            parts.append(f"{duration(left)} left" if rate > 0 else "none finished yet")
        else:
            parts.append(f"in {duration(spent)}")
        if failed:
            parts.append(f"{failed} failed")
        text = f"qbxstokes: {', '.join(parts)}"
        if self._style == "bar":
            full = _BAR * finished // max(self._total, 1)
            print(f"\r{'#' * full:.<{_BAR}} {text:<80}", end="", file=sys.stderr, flush=True)
            return
        print(text, file=sys.stderr, flush=True)
        self._interval = min(self._interval * _GROWTH, _LINE_INTERVALS[1])


class Advance:
    """Tells now and then how far a motion has come that takes more than some seconds."""

    def __init__(self, end: float, speak: bool) -> None:
        self._end = end
        self._interval = _LONG if speak else math.inf
        self._told = time.monotonic()

    def __call__(self, t: float, steps: int) -> None:
        """The integration is at t, after so many steps."""
        if time.monotonic() - self._told < self._interval or t >= self._end:
            return
        self._told = time.monotonic()
        self._interval = min(self._interval * _GROWTH, _LINE_INTERVALS[1])
        told = f"qbxstokes: t = {t:.6g} of {self._end:.6g}, {steps} steps"
        print(told, file=sys.stderr, flush=True)


@cache
def _tell_of_compilation() -> None:
    told = "qbxstokes: compiling kernels (once on a machine, some seconds) ..."
    print(told, file=sys.stderr, flush=True)


@contextmanager
def compilation_told(comm: Any, speak: bool) -> Iterator[None]:
    """Within it rank 0 says on standard error when a kernel has to be compiled, once.

    Kernels that numba finds in its cache on disk are loaded without a word. It imports numba: for
    runs that need it.
    """
    if comm.rank != 0 or not speak:
        yield
        return
    from numba.core import event

    class Teller(event.Listener):  # type: ignore[misc]
        def on_start(self, _: Any) -> None:
            _tell_of_compilation()

        def on_end(self, _: Any) -> None:
            """Nothing: what comes next tells of itself."""

    teller = Teller()
    event.register("numba:compile", teller)
    try:
        yield
    finally:
        event.unregister("numba:compile", teller)


@dataclass
class Clock:
    """Wall times of the parts of a run, in seconds."""

    parts: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Add the time spent inside to `name`, a stage of PETSc's log once PETSc has started."""
        begin = time.perf_counter()
        try:
            with stage(name):
                yield
        finally:
            self.parts[name] = self.parts.get(name, 0.0) + time.perf_counter() - begin

    @property
    def total(self) -> float:
        """Sum of the parts."""
        return sum(self.parts.values())
