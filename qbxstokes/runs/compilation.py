"""A sign of life while numba compiles: some seconds, once on a machine for each kind of kernel."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


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
        told = False

        def on_start(self, _: Any) -> None:
            if not self.told:
                self.told = True
                print(
                    "qbxstokes: compiling kernels (once on a machine, some seconds) ...",
                    file=sys.stderr,
                    flush=True,
                )

        def on_end(self, _: Any) -> None:
            """Nothing: what comes next tells of itself."""

    teller = Teller()
    event.register("numba:compile", teller)
    try:
        yield
    finally:
        event.unregister("numba:compile", teller)
