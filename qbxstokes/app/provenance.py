"""How a result was made: case, versions, options, machine."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any

from qbxstokes import __version__
from qbxstokes.config.load import LoadedCase


def provenance(loaded: LoadedCase, PETSc: Any, ranks: int, petsc: Sequence[str]) -> dict[str, Any]:
    """What the group `provenance` of a result holds."""
    return {
        "title": loaded.case.title,
        "case_file": str(loaded.path),
        "case": loaded.document.text,
        "overrides": json.dumps(list(loaded.document.overrides.values())),
        "resolved_case": json.dumps(loaded.resolved()),
        "version": __version__,
        "git_revision": git_revision(),
        "python": platform.python_version(),
        **{name: import_module(name).__version__ for name in ("numpy", "h5py", "mpi4py")},
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
        "petsc_options": json.dumps(PETSc.Options().getAll()),
        "command_line_for_petsc": " ".join(petsc),
        "ranks": ranks,
        "machine": machine(),
        "host": platform.node(),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def machine() -> str:
    """Processor, number of cores and operating system."""
    name = platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        name = models[0] if models else name
    except OSError:  # not Linux
        pass
    return f"{name}, {os.cpu_count()} cores, {platform.platform()}"


def git_revision() -> str:
    """Revision of the checkout this package runs from; empty for an installed package."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return ""
    try:
        return subprocess.run(
            ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12"],
            capture_output=True,
            text=True,
            timeout=5,
            check=True,
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
