"""Shared helpers: the command line and MPI as subprocesses, and warnings that are not ours."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qbxstokes.bie.functional import stokes_polynomials
from qbxstokes.flows.polynomial import PolynomialFlow

ROOT = Path(__file__).resolve().parents[1]

# One thread per process, and Open MPI allowed as root with more ranks than cores.
ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PYTHONPATH": str(ROOT),
}

Run = Callable[..., subprocess.CompletedProcess[str]]


def random_flow(degree: int, rng: np.random.Generator) -> PolynomialFlow:
    """A Stokes flow with all terms up to a degree."""
    tensors: list[Any] = [None, None, None]
    for d in range(1, degree + 1):
        basis = stokes_polynomials(d)
        tensors[d - 1] = np.tensordot(rng.standard_normal(len(basis)), basis, axes=1)
    return PolynomialFlow(rng.standard_normal(3), *tensors)


def pytest_configure(config: pytest.Config) -> None:
    # h5py 3.7 (Debian 12) calls numpy.product, which numpy 1.25 deprecates.
    config.addinivalue_line("filterwarnings", "ignore:`product` is deprecated:DeprecationWarning")


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


@pytest.fixture(scope="session", autouse=True)
def cache_of_the_tests(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A cache of their own: the user's holds what other environments may have formed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("QBXSTOKES_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def run_cli(tmp_path: Path) -> Run:
    """`run_cli("check", "case.yaml")`: the command line in a process of its own, in tmp_path."""

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
def write_case(tmp_path: Path) -> Callable[..., Path]:
    """`write_case({...})` or `write_case("yaml text")`: a case file in tmp_path."""

    def write(content: str | dict[str, Any], name: str = "case.yaml") -> Path:
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return path

    return write


@pytest.fixture
def asked_for(request: pytest.FixtureRequest) -> None:
    """Skips a test of minutes unless the command line says `-m slow`."""
    if "slow" not in request.config.option.markexpr.split():
        pytest.skip("takes minutes: run with -m slow")
