"""Shared helpers: the command line in this process or in its own, MPI, and which tests are run."""

# ruff: noqa: E402  (BLAS reads its number of threads when NumPy is imported)
from __future__ import annotations

import contextlib
import gc
import io
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

THREADS = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
os.environ.update(THREADS)

import numpy as np
import pytest

from qbxstokes.__main__ import main
from qbxstokes.bie.faxen import stokes_polynomials
from qbxstokes.cli.main import split_arguments
from qbxstokes.flows.polynomial import PolynomialFlow

ROOT = Path(__file__).resolve().parents[1]

# One thread per process; Open MPI allowed as root with more ranks than cores, and its ranks give
# way to other processes while they wait.
ENVIRONMENT = THREADS | {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_MCA_mpi_yield_when_idle": "1",
    "PYTHONPATH": str(ROOT),
}

Run = Callable[..., subprocess.CompletedProcess[str]]
See = Callable[..., None]


def script(name: str) -> Any:
    """A script below cases/ as a module, with those beside it that it imports."""
    path = ROOT / "cases" / f"{name}.py"
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    unique = name.replace("/", "_")  # two folders may each have a script of a name
    if unique not in sys.modules:
        spec = spec_from_file_location(unique, path)
        assert spec is not None
        assert spec.loader is not None
        sys.modules[unique] = module_from_spec(spec)
        spec.loader.exec_module(sys.modules[unique])
    return sys.modules[unique]


def random_flow(degree: int, rng: np.random.Generator) -> PolynomialFlow:
    """A Stokes flow with all terms up to a degree."""
    tensors: list[Any] = [None, None, None]
    for d in range(1, degree + 1):
        basis = stokes_polynomials(d)
        tensors[d - 1] = np.tensordot(rng.standard_normal(len(basis)), basis, axes=1)
    return PolynomialFlow(rng.standard_normal(3), *tensors)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--all", action="store_true", help="run every test, the slow ones too")


def pytest_configure(config: pytest.Config) -> None:
    # h5py 3.7 (Debian 12) calls numpy.product, which numpy 1.25 deprecates.
    config.addinivalue_line("filterwarnings", "ignore:`product` is deprecated:DeprecationWarning")
    if config.option.all:
        config.option.markexpr = ""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests that start ranks run one after the other: two jobs of two ranks share no two cores."""
    for item in items:
        if item.get_closest_marker("mpi") or "mpirun" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.xdist_group("mpi"))


def _run(command: Sequence[str], cwd: Path, timeout: float) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        cwd=cwd,
        env=os.environ | ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


@pytest.fixture
def run_study(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., dict[str, float]]:
    """`run_study("validation")`: the numbers of a script of cases/studies; its files must be there.

    Further arguments name its figures, if they are not called as the script.
    """

    def run(name: str, *figures: str) -> dict[str, float]:
        monkeypatch.chdir(tmp_path)
        found: dict[str, float] = script(f"studies/{name}").main(small=True)
        tables = list(tmp_path.glob(f"{name}*.csv"))
        assert max(len(table.read_text().splitlines()) for table in tables) > 4
        for figure in figures or (name,):
            assert (tmp_path / f"{figure}.pdf").read_bytes()[:4] == b"%PDF"
            assert (tmp_path / f"{figure}.png").stat().st_size < 150_000
        return found

    return run


@pytest.fixture(scope="session", autouse=True)
def cache_of_the_tests(
    tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> Iterator[None]:
    """A cache of their own, one for all workers: the user's may hold what others have formed."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if hasattr(request.config, "workerinput") else base) / "cache"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("QBXSTOKES_CACHE", str(folder))
        yield


@contextlib.contextmanager
def _as_it_was() -> Iterator[None]:
    """What a command may change of its process is put back: the next one finds it as if new."""
    folder, environment, path = Path.cwd(), dict(os.environ), list(sys.path)
    signals = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    threshold, errors, options = gc.get_threshold(), np.geterr(), _petsc_options()
    drawing = sys.modules.get("matplotlib")
    try:
        with drawing.rc_context() if drawing else contextlib.nullcontext():
            yield
    finally:
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        sys.path[:] = path
        for number, handler in signals.items():
            signal.signal(number, handler)
        gc.set_threshold(*threshold)
        np.seterr(**errors)
        _petsc_options(options)


def _petsc_options(wanted: dict[str, str] | None = None) -> dict[str, str]:
    """The options that PETSc holds, none where it has not started; `wanted` takes their place."""
    if "petsc4py.PETSc" not in sys.modules:
        return {}
    database = sys.modules["petsc4py.PETSc"].Options()
    present = dict(database.getAll())
    if wanted is not None and wanted != present:
        for name in present:
            database.delValue(name)
        for name, value in wanted.items():
            database.setValue(name, value)
    return present


@pytest.fixture(autouse=True)
def process_as_it_was() -> Iterator[None]:
    """Every test finds its process as the one before found it."""
    with _as_it_was():
        yield


@pytest.fixture
def run_cli(tmp_path: Path) -> Run:
    """`run_cli("check", "case.yaml")`: the command line in this process, in tmp_path.

    It leaves the process as it was. Options with one dash, which PETSc reads when it starts, are
    for `run_process`.
    """

    def run(*arguments: Any) -> subprocess.CompletedProcess[str]:
        words = [*map(str, arguments)]
        own, petsc = split_arguments(words)
        assert not (own and petsc), "PETSc has started: run_process"
        out, err = io.StringIO(), io.StringIO()
        with _as_it_was(), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            os.chdir(tmp_path)
            status = main(words)
        return subprocess.CompletedProcess(words, status, out.getvalue(), err.getvalue())

    return run


@pytest.fixture
def run_process(tmp_path: Path) -> Run:
    """The same in a process of its own, for what concerns the process."""

    def run(*arguments: Any, timeout: float = 120) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "qbxstokes", *map(str, arguments)]
        return _run(command, tmp_path, timeout)

    return run


@pytest.fixture
def mpirun(tmp_path: Path) -> Run:
    """`mpirun(2, "case.yaml")`: the command line on several ranks; skips where MPI is missing."""
    launcher = shutil.which("mpirun") or shutil.which("mpiexec")
    if launcher is None:
        pytest.skip("no mpirun on this machine")

    def run(
        ranks: int, *arguments: Any, script: str | None = None, timeout: float = 120
    ) -> subprocess.CompletedProcess[str]:
        program = ["-c", script] if script else ["-m", "qbxstokes"]
        command = [launcher, "-n", str(ranks), sys.executable, *program, *map(str, arguments)]
        return _run(command, tmp_path, timeout)

    return run


@pytest.fixture
def see(record_property: Callable[[str, object], None]) -> Iterator[See]:
    """`see(value, bound, "k = 2")`: asserts value <= bound; the worst is told when all has run."""
    worst, told = -1.0, ""

    def check(value: float, bound: float, where: str = "") -> None:
        nonlocal worst, told
        text = f"{value:.1e}, bound {bound:.0e}: {where}"
        assert value <= bound, text  # not a number is beyond every bound
        if value / bound > worst:
            worst, told = value / bound, text

    yield check
    record_property("worst", told)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """What came nearest to its bound in every test that saw some."""
    reports = [r for r in terminalreporter.stats.get("", []) if r.when == "teardown"]
    lines = [
        f"{report.nodeid.split('::')[1]:28}{text}"
        for report in reports
        for name, text in report.user_properties
        if name == "worst"
    ]
    if lines:
        terminalreporter.section("worst values")
        terminalreporter.write_line("\n".join(lines))


@pytest.fixture
def write_case(tmp_path: Path) -> Callable[..., Path]:
    """`write_case({...})` or `write_case("yaml text")`: a case file in tmp_path."""

    def write(content: str | dict[str, Any], name: str = "case.yaml") -> Path:
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return path

    return write
