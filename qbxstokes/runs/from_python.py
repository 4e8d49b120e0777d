"""Cases and sweeps from Python: what the command line does, as functions that return the result."""

from __future__ import annotations

import argparse
import atexit
import json
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from qbxstokes.case.document import document_of, given, parse, read_text
from qbxstokes.case.load import LoadedCase, checked
from qbxstokes.errors import CaseError, ConvergenceError
from qbxstokes.io.results import Result, load
from qbxstokes.io.store import free_name
from qbxstokes.runs.command import compute_case
from qbxstokes.runs.progress import Clock

if TYPE_CHECKING:
    from qbxstokes.io.results import SweepResult

_NAME = "case"  # what messages call a case that is no file


def run(
    case: Mapping[str, Any] | str | Path,
    *,
    file: str | Path | None = None,
    overwrite: bool = False,
    quiet: bool = True,
) -> Result:
    """Compute a case and return its result, arrays by name.

    case: the keys of a case file as a dictionary, or the path of a case file. In a dictionary NumPy
    arrays may stand for lists, flows (`qs.flow`) for their keys, and functions of Python wherever a
    file names one. Files that it names are relative to the working directory. file:
    where to keep the result (a free name is numbered unless overwrite); None: for as long as this
    process lives. quiet: False prints the summary. Raises CaseError for a case that is wrong, and
    ConvergenceError where it cannot be computed; trajectories of a sweep that fail are told in its
    table. Under mpirun all ranks call it and share the work.

    >>> import qbxstokes as qs
    >>> case = {
    ...     "body": {"aspect_ratio": 0.5, "stokes_number": 10},
    ...     "flow": {"type": "shear"},
    ...     "start": {"orientation": {"axis": [1, 0, 1]}},
    ...     "time": {"end": 5.0, "samples": 51},
    ... }
    >>> motion = qs.run(case)
    >>> motion.time.shape, motion.axis.shape
    ((51,), (51, 3))
    >>> motion.summary["errors"]["axis"] < 1e-9  # against semi-analytic equations
    True
    """
    return _computed(case, {}, file, overwrite, quiet)


def _computed(
    case: Mapping[str, Any] | str | Path,
    more: Mapping[str, Any],
    file: str | Path | None,
    overwrite: bool,
    quiet: bool,
    merge: bool = True,
) -> Result:
    """The result of a case with `more` keys."""
    from qbxstokes.runs.parallel import on_root, world

    if not isinstance(case, (Mapping, str, Path)):
        right = "a dictionary of its keys, or the path of a case file"
        raise CaseError(f"{_NAME}: is {case!r}; {right}, is expected")
    path = Path(f"{_NAME}.yaml") if isinstance(case, Mapping) else Path(case)
    keys = given({**(case if isinstance(case, Mapping) else {}), **more}, _NAME)  # by all ranks

    def read() -> LoadedCase:
        if isinstance(case, Mapping):
            document = document_of(keys, _NAME)
        else:
            document = parse(read_text(path), str(path))
            for key, value in keys.items():
                document.override(f"{key}={json.dumps(value)}")
        document.override(f"output.file={json.dumps(str(target))}")
        if not merge:
            document.override("output.merge=false")
        return checked(document, path)

    comm = world()
    wanted = Path(file) if file is not None else Path(_scratch(), "result.h5")
    target = on_root(comm, lambda: wanted if overwrite else free_name(wanted))
    options = argparse.Namespace(
        **dict.fromkeys(("explain", "dry_run", "resume", "no_cache", "json"), False),
        overwrite=overwrite,
        quiet=quiet,
        progress="none" if quiet else "auto",
    )

    with _own_options():
        status = compute_case(comm, path, read, options, (), Clock())
    result = load(target)
    if status and result.task != "sweep":
        raise ConvergenceError(f"{target}: the result exceeds a limit that the case sets")
    return result


def sweep(
    case: Mapping[str, Any] | str | Path,
    axes: Mapping[str, ArrayLike | Mapping[str, Any]],
    *,
    file: str | Path | None = None,
    overwrite: bool = False,
    quiet: bool = True,
    merge: bool = True,
    **section: Any,
) -> SweepResult:
    """Compute a case for all combinations of values of some of its keys.

    axes: key of the case -> its values (n,), or {"logspace": [a, b], "count": n} and the like, as
    in the section `sweep` of a case file; `section` takes the other keys of that section, such as
    store="summary". merge: False leaves the rows in parts beside the file, which shows them as one
    (half the disk). The rest as for `run`. In the result, `table` has a row per trajectory and
    `shape` an entry per axis.

    >>> import numpy as np, qbxstokes as qs
    >>> case = {
    ...     "body": {"aspect_ratio": 0.5},
    ...     "flow": {"type": "shear"},
    ...     "start": {"orientation": {"axis": [1, 0, 1]}},
    ...     "time": {"periods": 2, "samples": 101},
    ... }
    >>> k = np.array([0.2, 0.5, 2.0])
    >>> orbits = qs.sweep(case, {"body.aspect_ratio": k})
    >>> np.allclose(orbits.table["period"], 2 * np.pi * (k + 1 / k))
    True
    >>> orbits.axis.shape
    (3, 101, 3)
    """
    whole = {"axes": [{key: values} for key, values in axes.items()], **section}
    result = _computed(case, {"sweep": whole}, file, overwrite, quiet, merge)
    return result  # type: ignore[return-value]


@cache
def _scratch() -> str:
    """A folder that lives as long as this process."""
    holder = tempfile.TemporaryDirectory(prefix="qbxstokes-")
    atexit.register(holder.cleanup)
    return holder.name


@contextmanager
def _own_options() -> Iterator[None]:
    """PETSc's options are afterwards as they were before: those of a case end with it."""
    from qbxstokes.petsc import session

    options = session.start().Options()
    before = dict(options.getAll())
    try:
        yield
    finally:
        for name in set(options.getAll()) - set(before):
            options.delValue(name)
