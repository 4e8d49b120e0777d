"""How a result was made: case, versions, options, machine."""

import json
import os
import platform
import subprocess
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any

from qbxstokes import __version__
from qbxstokes.case.load import LoadedCase


def provenance(
    loaded: LoadedCase, PETSc: Any, ranks: int, petsc: Sequence[str], revision: Callable[[], str]
) -> dict[str, Any]:
    """What the group `provenance` of a result holds."""
    physical = {}
    if loaded.case.units is not None:
        scales = loaded.case.units.scales
        physical = {"units": scales.given, "scales": scales.table() | scales.numbers}
    return {
        "title": loaded.case.title,
        "case_file": str(loaded.path),
        "case": loaded.document.text,
        "overrides": json.dumps(list(loaded.document.overrides.values())),
        "resolved_case": json.dumps(loaded.resolved()),
        **physical,
        "version": __version__,
        "git_revision": revision(),
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
    # Not by platform.platform(), which starts a process to ask for the processor once more.
    system = " ".join((platform.system(), platform.release(), *platform.libc_ver()))
    return f"{name}, {os.cpu_count()} cores, {system}"


def asked_revision() -> Callable[[], str]:
    """Ask git for the revision of the checkout this package runs from; the result tells it.

    Empty for an installed package.
    """
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return str
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        asked = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
    except OSError:
        return str

    def answer() -> str:
        try:
            told, _ = asked.communicate(timeout=5)
        except (OSError, subprocess.SubprocessError):
            asked.kill()
            asked.communicate()
            return ""
        return told.strip() if asked.returncode == 0 else ""

    return answer
