"""Where a result goes, what its numbers depend on, how it was made: case, versions, machine.

A run goes on only if nothing of what the numbers depend on has changed.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from qbxstokes import __version__
from qbxstokes.case.document import plain
from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import CaseError
from qbxstokes.flows.user import LIBRARIES
from qbxstokes.io.format import first_difference
from qbxstokes.io.names import check_writable, numbered, parts_of, told_by
from qbxstokes.io.store import NUMBERED, Work, free_name, holds_work, open_work, remove_remains
from qbxstokes.runs.parallel import on_root

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job


# Bytes from which a file counts by its ends, and of each end.
_LARGE, _END = 2**28, 2**20
# Sections that no number depends on, for every task.
_IRRELEVANT = ("title", "output", "compare", "checkpoint")


def result_path(loaded: LoadedCase) -> Path:
    """The result file that the case asks for."""
    return Path(loaded.case.output.file or f"{loaded.path.stem}.h5")


def target_of(loaded: LoadedCase, overwrite: bool = False) -> Path:
    """The file that will be written: the one asked for, or the next free name.

    Raises CaseError where it cannot be written.
    """
    output = result_path(loaded)
    overwrite = overwrite or loaded.case.output.overwrite
    try:
        check_writable(output, overwrite)
    except CaseError as error:
        raise loaded.error("output.file", str(error)) from None
    return output if overwrite else free_name(output)


def identity_of(
    loaded: LoadedCase, options: list[str], irrelevant: tuple[str, ...] = (), **more: Any
) -> dict[str, Any]:
    """Case, PETSc options and the contents of the files that the case names, as plain data.

    irrelevant: further sections that may change. more: what else the numbers depend on. Functions
    of Python files count by the text of their file.
    """
    resolved = loaded.resolved()
    kept = {k: v for k, v in resolved.items() if k not in (*_IRRELEVANT, *irrelevant)}
    sections = {k: v for k, v in loaded.document.data.items() if k in kept}
    if loaded.space is not None:
        sections["sweep"] = loaded.document.data["sweep"]
    files = dict(_files(sections, loaded.path.parent))
    return dict(json.loads(json.dumps(plain({**kept, **more, "options": options, "files": files}))))


def finished_result(loaded: LoadedCase, identity: Mapping[str, Any]) -> Path | None:
    """The result that an earlier run of this case has left, where nothing is left to go on with.

    None without any result, or with an unfinished run. Raises CaseError where there are results of
    other cases alone.
    """
    names = list(islice(numbered(result_path(loaded)), NUMBERED))
    if any(holds_work(parts_of(name)) for name in names):
        return None
    other = ""
    for path in names:
        text = told_by(path, "identity", complete=True)
        if text is None:
            continue
        difference = first_difference(json.loads(text), identity)
        if difference is None:
            remove_remains(path)
            return path
        other = other or f"{path}: is the result of a run with another {difference}"
    if other:
        raise CaseError(f"{other}, and no unfinished run is left to go on with; leave out --resume")
    return None


@contextmanager
def working_folder(
    job: Job,
    identity: Mapping[str, Any],
    kept: Callable[[Work], Any] = lambda _: None,
    reopened: Callable[[Path], Work | None] = lambda _: None,
) -> Iterator[tuple[Work | None, Any]]:
    """The working folder of the case's result for this rank, held by rank 0, and what is in it.

    kept: says on rank 0 what earlier runs have left in the folder. reopened: the folder of a
    finished result that something is left to do of, None where nothing is. Without a folder: the
    result of this very run, where nothing is left to go on with. The folder goes at the end unless
    it `stays`; where an error ends the run, only if nothing is in it.
    """
    comm, loaded, resume = job.comm, job.loaded, job.options.resume
    own: list[Work] = []

    def opened() -> tuple[Work | None, Any]:
        done = finished_result(loaded, identity) if resume and not job.overwrite else None
        work = None if done is None else reopened(done)
        if done is not None and work is None:
            return None, done
        asked = result_path(loaded)
        work = work or open_work(asked, identity, resume=resume, overwrite=job.overwrite)
        try:
            found = kept(work)
            work.note_run()
        except BaseException:
            work.close(remove=not holds_work(work.folder))
            raise
        own.append(work)
        return work.joined(0), found

    folder, found = on_root(comm, opened)
    if folder is None:
        yield None, found
        return
    folder = own[0] if own else folder.joined(comm.rank)
    try:
        yield folder, found
    except BaseException:
        folder.close(remove=comm.rank == 0 and not holds_work(folder.folder))
        raise
    folder.close(remove=comm.rank == 0 and not folder.stays)


def fingerprint(path: Path) -> str:
    """What tells a file from another: the hash of its contents, of a large one that of its ends.

    A large one counts by its size and the time of its last change, too: to read 360 GB would take
    as long as the run.
    """
    facts = path.stat()
    with path.open("rb") as stream:
        if facts.st_size <= _LARGE:
            return hashlib.file_digest(stream, "sha256").hexdigest()
        digest = hashlib.sha256(f"{facts.st_size} {facts.st_mtime_ns} ".encode())
        digest.update(stream.read(_END))
        stream.seek(-_END, os.SEEK_END)
        digest.update(stream.read(_END))
    return f"ends {digest.hexdigest()}"


def _files(value: Any, folder: Path) -> Iterator[tuple[str, str]]:
    """Files that nested data name, each with the hash of its contents."""
    if isinstance(value, Mapping):
        for entry in value.values():
            yield from _files(entry, folder)
    elif isinstance(value, list):
        for entry in value:
            yield from _files(entry, folder)
    elif isinstance(value, str):
        stem, colon, _ = value.rpartition(":")
        name = stem if colon and stem.endswith((".py", *LIBRARIES)) else value
        try:
            path = folder / name
            if "." in name and path.is_file():
                yield name, fingerprint(path)
        except (OSError, ValueError):
            return


# -- how a result was made -------------------------------------------------------------------------


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
