"""What the environment is like, what is wrong with it, and what to do about that."""

import importlib
import os
import platform
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from qbxstokes import __version__
from qbxstokes.folders import default_folder, folder_of_compiled, unwritable
from qbxstokes.runs.report import beside, counted, size


@dataclass(frozen=True)
class Finding:
    """One line of the examination."""

    name: str
    ok: bool
    text: str
    advice: str = ""


def examine() -> list[Finding]:
    """Findings on versions, MPI, PETSc, threads, write access and the cache."""
    return [
        Finding("qbxstokes", True, f"{__version__}, Python {platform.python_version()}"),
        _package("numpy"),
        _package("scipy"),
        _package("numba", "only large batches and the set-up need it"),
        _package("h5py"),
        _package("yaml", distribution="pyyaml"),
        _package("matplotlib", "only plots need it"),
        _mpi(),
        _petsc(),
        _launcher(),
        _threads(),
        _writable("working directory", os.getcwd()),
        _writable("temporary files", tempfile.gettempdir()),
        _cache(),
        _compiled(),
    ]


def report(findings: Sequence[Finding]) -> str:
    """A line for each finding, wrapped beside its name, and what to do about it below."""
    lines = []
    for finding in findings:
        head = f"{'ok  ' if finding.ok else 'BAD '} {finding.name:18} "
        lines += beside(head, finding.text, len(head))
        lines += beside(" " * len(head), finding.advice, len(head))
    return "\n".join(lines)


def _package(name: str, use: str = "", distribution: str = "") -> Finding:
    try:
        module = importlib.import_module(name)
    except ImportError as error:
        advice = f"{use + '; ' if use else ''}python -m pip install {distribution or name}"
        return Finding(distribution or name, bool(use), f"missing ({error})", advice)
    return Finding(distribution or name, True, getattr(module, "__version__", "present"))


def _mpi() -> Finding:
    try:
        mpi: Any = importlib.import_module("mpi4py.MPI")
    except (ImportError, RuntimeError) as error:
        advice = "install mpi4py and the MPI that it was built for, from the same source"
        return Finding("mpi4py", False, f"does not work ({error})", advice)
    library = mpi.Get_library_version().split(",")[0].splitlines()[0].strip("\0 ")
    return Finding("mpi4py", True, f"{importlib.import_module('mpi4py').__version__}, {library}")


def _petsc() -> Finding:
    try:
        from qbxstokes.petsc.session import start

        petsc = start()
    except ImportError as error:
        advice = "./run.sh install makes an environment with petsc4py"
        return Finding("petsc4py", False, f"does not work ({error})", advice)
    version = ".".join(map(str, petsc.Sys.getVersion()))
    real = petsc.ScalarType().dtype.kind == "f"
    index = petsc.IntType().dtype.itemsize * 8
    text = f"PETSc {version}, {'real' if real else 'complex'} numbers, {index}-bit indices"
    advice = "" if real else "install petsc4py for real numbers (python3-petsc4py-real on Debian)"
    return Finding("petsc4py", real, text, advice)


def _launcher() -> Finding:
    launcher = shutil.which("mpirun") or shutil.which("mpiexec")
    if launcher is None:
        advice = "install openmpi-bin (or MPICH) to use several ranks"
        return Finding("mpirun", True, "not found; single process only", advice)
    advice = ""
    if os.geteuid() == 0 and "OMPI_ALLOW_RUN_AS_ROOT" not in os.environ:
        advice = "as root, Open MPI wants OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1"
    return Finding("mpirun", True, launcher, advice)


def _threads() -> Finding:
    cores = len(os.sched_getaffinity(0))
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
    chosen = [f"{name}={os.environ[name]}" for name in names if name in os.environ]
    return Finding("threads", True, f"{cores} cores; {', '.join(chosen) or 'no limits set'}")


def _writable(name: str, folder: str) -> Finding:
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        return Finding(name, False, f"{folder}: cannot write ({error.strerror})", "choose another")
    free = shutil.disk_usage(folder).free / 2**30
    return Finding(name, True, f"{folder}: writable, {free:.1f} GiB free")


def _compiled() -> Finding:
    folder, told = folder_of_compiled()
    if folder is not None:
        return Finding("compiled", True, f"{folder}: compiled functions are kept there")
    advice = "they are compiled anew in each run; name a folder of your own in QBXSTOKES_CACHE"
    if "NUMBA_CACHE_DIR" in os.environ:
        advice = advice.replace("QBXSTOKES_CACHE", "NUMBA_CACHE_DIR, or unset it")
    return Finding("compiled", False, told, advice)


def _cache() -> Finding:
    folder = default_folder()
    if folder is None:
        return Finding("cache", True, "off (QBXSTOKES_CACHE is empty)")
    if told := unwritable(folder):
        advice = "nothing is kept between runs; name another folder in QBXSTOKES_CACHE"
        return Finding("cache", False, told, advice)
    files = [file for file in folder.rglob("*") if file.is_file()] if folder.is_dir() else []
    held = sum(file.stat().st_size for file in files)
    return Finding(
        "cache", True, f"{folder}: {counted(len(files), 'entry', 'entries')}, {size(held)}"
    )
