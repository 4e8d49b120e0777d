"""Start PETSc once, with the options of the case below those of the command line."""

import atexit
import gc
import signal
import sys
import threading
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from qbxstokes.errors import CaseError
from qbxstokes.petsc.launch import starting_mpi
from qbxstokes.solver_options import given, misleading

# What the names of the linear solver's options begin with.
SOLVER_OPTIONS = ("ksp_", "pc_")
# Whoever holds objects of PETSc that call Python, and may still do so when the interpreter ends.
LIVE: weakref.WeakSet[Any] = weakref.WeakSet()


def start(arguments: Sequence[str] = (), options: Mapping[str, Any] | None = None) -> Any:
    """Initialise PETSc and return the petsc4py.PETSc module.

    arguments: the command line that is left for PETSc. options: the `petsc:` section of the case,
    which yields to the command line and to PETSC_OPTIONS; a value of None or True makes a flag.
    Later calls only add options. Raises CaseError as `require_honest` does.
    """
    import petsc4py

    # Every call of petsc4py's own adds one more collective clean-up at the exit, which ranks that
    # have called it more often than others would wait in for ever.
    if "petsc4py.PETSc" not in sys.modules:
        gc.freeze()  # nothing so far holds an object of PETSc: `_release` need not look through it
        with starting_mpi():
            # Files named .petscrc are no place that options are known to come from.
            petsc4py.init(["qbxstokes", "-skip_petscrc", *arguments])
        _keep_pipes()
    from petsc4py import PETSc

    atexit.unregister(_release)
    atexit.register(_release)
    database = PETSc.Options()
    for name, value in given(options or {}).items():
        if not database.hasName(name):
            database.setValue(name, value)
    require_honest()
    return PETSc


def _keep_pipes() -> None:
    """A pipe that is closed is an error of whoever writes, as before PETSc, and ends no process."""
    before = signal.getsignal(signal.SIGPIPE)  # what Python knows, not what PETSc has set
    if before is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGPIPE, before)


def require_honest() -> None:
    """Raise CaseError for an option that would make a motion wrong without a word."""
    from petsc4py import PETSc

    for name, wrong, right in misleading(PETSc.Options().getAll()):
        raise CaseError(f"PETSc option -{name}: {wrong}; {right}")


@contextmanager
def stage(name: str) -> Iterator[None]:
    """A stage of `-log_view`, so that PETSc's own events are told apart by part of the run."""
    PETSc = sys.modules.get("petsc4py.PETSc")
    if PETSc is None or not PETSc.Sys.isInitialized() or PETSc.Sys.isFinalized():
        yield
        return
    # PETSc knows the stage by its name: entering it again goes on with the same one.
    with PETSc.Log.Stage(name):
        yield


@contextmanager
def temporary_options(
    prefix: str, defaults: Mapping[str, str], forced: Mapping[str, str]
) -> Iterator[None]:
    """Options that hold while an object reads its own.

    `defaults` yield to what the user has set, `forced` do not; all are taken back at the end, so
    that the database holds the user's options alone.
    """
    from petsc4py import PETSc

    database = PETSc.Options()
    before = database.getAll()
    wanted = {name: value for name, value in defaults.items() if prefix + name not in before}
    values = {prefix + name: value for name, value in (wanted | dict(forced)).items()}
    for name, value in values.items():
        database.setValue(name, value)
    try:
        yield
    finally:
        for name in values:
            database.delValue(name)
            if name in before:
                database.setValue(name, before[name])


@contextmanager
def own_options(values: Mapping[str, Any]) -> Iterator[None]:
    """Options that hold for a while in the place of all others of their names; None: not given."""
    from petsc4py import PETSc

    database = PETSc.Options()
    before = {name: text for name, text in database.getAll().items() if name in values}
    _replace(database, values)
    try:
        yield
    finally:
        _replace(database, dict.fromkeys(values) | before)


def _replace(database: Any, values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        database.delValue(name)
        if value is not None:
            whole = isinstance(value, float) and value.is_integer()
            database.setValue(name, None if value is True else str(int(value) if whole else value))


def _release() -> None:
    """Destroy what Python has let go of, while Python still runs.

    An object found by Python's cyclic collector is only put on PETSc's list of garbage. Left for
    PetscFinalize, which comes after the end of the interpreter, a shell matrix or preconditioner
    would call into Python there, and crash.
    """
    from petsc4py import PETSc

    for holder in list(LIVE):
        holder.release()
    gc.collect()
    PETSc.garbage_cleanup(PETSc.COMM_SELF)


def solver_options(PETSc: Any) -> list[str]:
    """Names of the options for the linear solver that the user gave."""
    names = PETSc.Options().getAll()
    return sorted(name for name in names if name.startswith(SOLVER_OPTIONS))


def stepper_options(PETSc: Any) -> list[str]:
    """The options for the time stepper that the user gave, monitors apart, as `name value`."""
    options = PETSc.Options().getAll()
    return sorted(
        f"{name} {value}".strip()
        for name, value in options.items()
        if name.startswith(("ts_", "snes_")) and "monitor" not in name and "view" not in name
    )


def unused_options(PETSc: Any) -> list[str]:
    """Names of the options that nothing has asked for.

    petsc4py has no wrapper of PetscOptionsLeftGet in the versions that are supported, so the C
    function is called in the library that petsc4py has loaded.
    """
    import ctypes

    integer = ctypes.c_int64 if PETSc.IntType().dtype.itemsize == 8 else ctypes.c_int32
    library = ctypes.CDLL(PETSc.__file__)
    count = integer()
    names, values = (ctypes.POINTER(ctypes.c_char_p)() for _ in range(2))
    arguments = (None, ctypes.byref(count), ctypes.byref(names), ctypes.byref(values))
    if library.PetscOptionsLeftGet(*arguments):
        return []
    found = sorted(names[index].decode() for index in range(count.value))
    library.PetscOptionsLeftRestore(*arguments)
    return found
