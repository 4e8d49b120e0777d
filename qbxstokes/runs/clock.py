"""Wall times of the parts of a run, which are the stages of `-log_view` as well."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from qbxstokes.petsc.session import stage


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
