"""Set-up: the thesis's uniform scheme against the graded one, what each skip saves, the cache."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.app.benchmark.accuracy import model_error
from qbxstokes.bie.accuracy import AccurateBody, accurate_body, choose_scheme, plain_body
from qbxstokes.bie.operators import form_body_model, modal_functional, surface_operators
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.cache import Cache
from qbxstokes.io.tables import Column, Table
from qbxstokes.qbx.operator import Scheme, UniformScheme, independent_rows, layer_rows

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work

# Aspect ratio, n_theta, order, r/h, upsampling: the cheapest of a scan of the uniform scheme that
# comes near the accuracy that it can reach in seconds.
_UNIFORM = ((0.2, 24, 4, 0.076, 16), (0.5, 24, 14, 0.477, 16), (2.0, 24, 14, 0.955, 16))


def timed(
    action: Callable[[], Any], repeats: int, clock: Callable[[], float] = time.thread_time
) -> tuple[float, Any]:
    """Median time of the repeats (s) and the last result.

    Unless a clock is given, processor time of this thread, which does all the work and is not
    disturbed by whatever else the machine does.
    """
    times, result = [], None
    for _ in range(repeats):
        start = clock()
        result = action()
        times.append(clock() - start)
    return median(times), result


def tables(work: Work) -> Iterator[Table]:
    """The four tables; small: one aspect ratio and no repeats."""
    repeats = work.choose(1, 5)
    yield _schemes(work.choose(_UNIFORM[1:2], _UNIFORM), repeats)
    yield _tolerance(work.choose((0.5,), (0.02, 0.1, 0.5, 1.0, 2.0, 10.0, 50.0)), repeats)
    yield _skips(work.choose(1, 7))


def _schemes(cases: tuple[tuple[float, int, int, float, int], ...], repeats: int) -> Table:
    table = Table(
        "schemes",
        "Set-up at equal error: uniform against graded",
        (
            Column("aspect_ratio", "", "k", ".3g"),
            Column("uniform", "", "n_theta, p, r/h, kappa"),
            Column("uniform_error", "", "resistance and Faxen coefficients", ".1e"),
            Column("uniform_time", "s", "processor time of operators and functional", ".3g"),
            Column("graded_error", "", "", ".1e"),
            Column("graded_time", "s", "", ".3g"),
            Column("ratio", "", "uniform time over graded time", ".0f"),
            Column("passed", "", "at least 50, at no larger error"),
        ),
    )
    for k, n, order, r_over_h, kappa in cases:
        form = partial(plain_body, Spheroid(k))
        uniform = UniformScheme(n, n, order, r_over_h, kappa)
        slow, body = timed(partial(form, uniform), min(repeats, 3))
        error = model_error(body)
        fast, better = timed(partial(form, choose_scheme(error)), repeats)
        table.add(
            aspect_ratio=k,
            uniform=f"{n}, {order}, {r_over_h:g}, {kappa}",
            uniform_error=error,
            uniform_time=slow,
            graded_error=model_error(better),
            graded_time=fast,
            ratio=slow / fast,
            passed=slow >= 50.0 * fast and model_error(better) <= error,
        )
    table.notes.append("Both by rotational and mirror symmetry, by the same kernels, two modes.")
    return table


def _tolerance(ratios: tuple[float, ...], repeats: int) -> Table:
    table = Table(
        "setup",
        "Set-up at tolerance 1e-10, with the error estimate, and from the cache",
        (
            Column("aspect_ratio", "", "k", ".3g"),
            Column("sources", "", "source points of the three rows", "d"),
            Column("form", "s", "processor time of operators and functional", ".3g"),
            Column("total", "s", "the same with the estimate", ".3g"),
            Column("cached", "s", "wall time to read it back from disk", ".2g"),
            Column("error", "", "true error", ".1e"),
        ),
    )
    with tempfile.TemporaryDirectory() as folder:
        for k in ratios:
            alone, _ = timed(partial(plain_body, Spheroid(k), choose_scheme(1e-10)), repeats)
            total, body = timed(partial(accurate_body, Spheroid(k), 1e-10), repeats)
            cache, key = Cache(Path(folder)), {"aspect_ratio": k}
            cache.store("body", key, body.to_arrays())
            cached, _ = timed(partial(_read, cache, key), repeats, time.perf_counter)
            table.add(
                aspect_ratio=k,
                sources=_sources(k, body.scheme),
                form=alone,
                total=total,
                cached=cached,
                error=model_error(body),
            )
    return table


def _read(cache: Cache, key: dict[str, Any]) -> AccurateBody:
    arrays = cache.load("body", key)
    assert arrays is not None
    return AccurateBody.from_arrays(arrays)


def _sources(k: float, scheme: Scheme) -> int:
    spheroid, grid = Spheroid(k), scheme.grid(Spheroid(k), 1)
    total = 0
    for row in independent_rows(scheme.n_theta):
        rule = scheme.rule(spheroid, float(grid.theta[row]), -1, 2)
        total += int(np.sum(rule[3] - rule[2]))
    return total


def _skips(repeats: int) -> Table:
    table = Table(
        "skips",
        "What the plan leaves out: change of the result and time saved (k = 1/2, tolerance 1e-10)",
        (
            Column("skip", "", ""),
            Column("without", "ms", "processor time with nothing skipped", ".3g"),
            Column("skipped", "ms", "processor time with the skip", ".3g"),
            Column("saving", "", "ratio of the two", ".2g"),
            Column("change", "", "largest relative change of the result", ".0e"),
            Column("passed", "", "no more than rounding"),
        ),
    )
    for name, full, short in skips():
        slow, before = timed(full, repeats)
        fast, after = timed(short, repeats)
        change = float(np.max(np.abs(before - after)) / np.max(np.abs(before)))
        table.add(
            skip=name,
            without=1e3 * slow,
            skipped=1e3 * fast,
            saving=slow / fast,
            change=change,
            passed=change < 1e-11,
        )
    return table


def skips(k: float = 0.5) -> Iterator[tuple[str, Callable[[], Any], Callable[[], Any]]]:
    """Name of each skip, the work without it and with it; both give comparable arrays."""
    from qbxstokes.bie.functional import faxen_coefficients
    from qbxstokes.bie.providers import GridMotion, SolveMotion
    from qbxstokes.flows.named import Shear
    from qbxstokes.motion.equations import RigidBodyEquations

    spheroid, scheme = Spheroid(k), choose_scheme(1e-10)
    both = replace(choose_scheme(1e-10, side="average"), n_theta=scheme.n_theta)
    every = range(scheme.n_theta)
    half = independent_rows(scheme.n_theta)
    flow = Shear()
    operators = surface_operators(spheroid, scheme, 8)
    functional = modal_functional(operators)
    model = form_body_model(operators)
    x, q = np.zeros((1, 3)), np.array([[0.8, 0.3, -0.4, 0.33]])
    q /= np.linalg.norm(q)

    def model_of(n_phi: int, used: Scheme) -> Any:
        chosen = surface_operators(spheroid, used, n_phi)
        coefficients, _ = faxen_coefficients(modal_functional(chosen))
        return np.concatenate([coefficients.quadratic, coefficients.cubic])

    def motion(provider: Any) -> Any:
        return np.concatenate(provider.free_motion(0.0, x, q))

    def table_motion() -> Any:
        return np.concatenate(equations.velocities(0.0, state))

    equations = RigidBodyEquations(model, flow)
    state = equations.initial_state(x[0], q[0])
    solve = SolveMotion(operators, flow)
    grid = GridMotion(functional.on_grid(8), flow)
    motion(solve)
    yield (
        "azimuthal modes above 1",
        lambda: model_of(8, scheme),
        lambda: model_of(3, scheme),
    )
    yield "outer expansions", lambda: model_of(3, both), lambda: model_of(3, scheme)
    yield (
        "rows that mirror symmetry gives",
        lambda: layer_rows(spheroid, scheme, 2, every)[0][: len(half)],
        lambda: layer_rows(spheroid, scheme, 2, half)[0],
    )
    yield "integral equation at a step", lambda: motion(solve), lambda: motion(grid)
    yield "flow on the surface at a step", lambda: motion(grid), table_motion
