"""Set-up: the thesis's uniform scheme against the graded one, what each skip saves, the cache."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.app.benchmark.timing import peak_memory, timed
from qbxstokes.bie.accuracy import AccurateBody, accurate_body, choose_scheme, plain_body
from qbxstokes.bie.exact import true_error
from qbxstokes.bie.operators import form_body_model, modal_functional, surface_operators
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.cache import Cache
from qbxstokes.io.tables import Column, Table
from qbxstokes.qbx.operator import GradedScheme, Scheme, UniformScheme, independent_rows, layer_rows
from qbxstokes.reference import jeffery

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work
    from qbxstokes.bie.resistance import Completion

# Bodies of a block; right-hand sides timed together, since one alone is too short.
_BLOCK, _CALLS = 512, 1000

# Aspect ratio, n_theta, order, r/h, upsampling: on the front of error against time of a scan of the
# uniform scheme over all four, up to seconds a body.
_UNIFORM = (
    (0.2, 12, 2, 0.069, 12),
    (0.2, 24, 2, 0.138, 10),
    (0.2, 24, 4, 0.076, 16),
    (0.5, 12, 8, 0.358, 6),
    (0.5, 8, 8, 0.191, 16),
    (0.5, 16, 14, 0.382, 12),
    (0.5, 24, 14, 0.477, 16),
    (2.0, 8, 6, 0.573, 12),
    (2.0, 20, 12, 1.432, 8),
    (2.0, 20, 16, 1.194, 12),
    (2.0, 24, 14, 0.955, 16),
    (5.0, 12, 2, 0.344, 12),
    (5.0, 24, 4, 0.688, 12),
)


def tables(work: Work) -> Iterator[Table]:
    """The three tables; small: one aspect ratio and no repeats.

    Times are processor times of this thread, which does all the work, unless they say otherwise.
    """
    repeats = work.choose(1, work.section.repeats)
    yield _schemes(work.choose(_UNIFORM[4:5], _UNIFORM), repeats)
    ratios = work.choose((0.5,), (0.02, 0.1, 0.5, 1.0, 2.0, 10.0, 50.0))
    yield _tolerance(ratios, work.choose((1e-10,), (1e-4, 1e-7, 1e-10)), repeats)
    yield _skips(work.choose(1, 7))


def _schemes(cases: tuple[tuple[float, int, int, float, int], ...], repeats: int) -> Table:
    table = Table(
        "schemes",
        "Set-up at equal error: the thesis's uniform scheme against the graded one",
        (
            Column("aspect_ratio", "", "k", ".3g", "k"),
            Column("scheme"),
            Column("parameters", "", "n_theta, p, r/h, kappa; n_theta, p, panel nodes"),
            Column("error", "", "resistance and Faxen coefficients", ".1e"),
            Column("time", "s", "processor time of operators and functional", ".2g"),
            Column("ratio", "", "time over that of the graded scheme at no larger error", ".3g"),
            Column("memory", "MB", "at its largest", ".3g"),
            Column("iterations", "", "of GMRES to 1e-10, without preconditioner", "d"),
            Column("passed", "", "the error is no larger than the uniform one's"),
        ),
        plot={"x": "time", "y": "error", "by": "scheme", "points": True, "scale": "loglog"},
    )
    for k, n, order, r_over_h, kappa in cases:
        uniform = _formed(k, UniformScheme(n, n, order, r_over_h, kappa), min(repeats, 3))
        graded = _formed(k, choose_scheme(uniform["error"]), repeats)
        for row in (uniform, graded):
            ratio = row["time"] / graded["time"]
            table.add(**row, ratio=ratio, passed=row["error"] <= uniform["error"])
    table.notes.append("Both by rotational and mirror symmetry, by the same kernels, two modes.")
    return table


def _formed(k: float, scheme: UniformScheme | GradedScheme, repeats: int) -> dict[str, Any]:
    """What one body costs: a row of the table but for what compares it."""
    from qbxstokes.petsc.gmres import GmresSolver

    form = partial(plain_body, Spheroid(k), scheme)
    memory = peak_memory(form)
    span, body = timed(form, repeats, time.thread_time)
    operators = surface_operators(Spheroid(k), scheme, 3)
    solver = GmresSolver(operators.mobility, operators.grid, 1e-10, False)
    solver.solve(np.random.default_rng(0).standard_normal((operators.grid.weights.size, 3)))
    if isinstance(scheme, UniformScheme):
        name = "uniform"
        numbers = [scheme.n_theta, scheme.expansion_order, scheme.r_over_h, scheme.upsampling]
    else:
        name, numbers = "graded", [scheme.n_theta, scheme.expansion_order, scheme.panel_order]
    return {
        "aspect_ratio": k,
        "scheme": name,
        "parameters": ", ".join(f"{number:g}" for number in numbers),
        "error": true_error(body.model),
        "time": span,
        "memory": memory,
        "iterations": solver.records[-1].iterations,
    }


def _tolerance(ratios: tuple[float, ...], tolerances: tuple[float, ...], repeats: int) -> Table:
    table = Table(
        "setup",
        "Set-up to a tolerance, with the error estimate, and from the cache",
        (
            Column("aspect_ratio", "", "k", ".3g", "k"),
            Column("tolerance", "", "asked for", ".0e"),
            Column("sources", "", "source points of all rows", "d"),
            Column("form", "s", "processor time of operators and functional", ".2g"),
            Column("total", "s", "the same with the estimate", ".2g"),
            Column("cached", "s", "wall time to read it back from disk", ".2g"),
            Column("ratio", "", "total over cached", ".3g"),
            Column("error", "", "true error", ".1e"),
            Column("passed", "", "the error is below the tolerance"),
        ),
        plot={"x": "total", "y": "error", "by": "aspect_ratio", "scale": "loglog"},
    )
    with tempfile.TemporaryDirectory() as folder:
        for k, tolerance in product(ratios, tolerances):
            whole = partial(accurate_body, Spheroid(k), tolerance)
            total, body = timed(whole, repeats, time.thread_time)
            simple = partial(plain_body, Spheroid(k), body.scheme)
            alone, _ = timed(simple, repeats, time.thread_time)
            cache, key = Cache(Path(folder)), {"aspect_ratio": k, "tolerance": tolerance}
            cache.store("body", key, body.to_arrays())
            cached, _ = timed(partial(_read, cache, key), repeats)
            error = true_error(body.model)
            table.add(
                aspect_ratio=k,
                tolerance=tolerance,
                sources=_sources(k, body.scheme),
                form=alone,
                total=total,
                cached=cached,
                ratio=total / cached,
                error=error,
                passed=error <= tolerance,
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
        "What the plan leaves out: change of the result, time saved (k = 1/2, 1e-10)",
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
        slow, before = timed(full, repeats, time.thread_time)
        fast, after = timed(short, repeats, time.thread_time)
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
    from qbxstokes.bie.functional import FaxenCoefficients, faxen_coefficients
    from qbxstokes.bie.providers import GridMotion, SolveMotion
    from qbxstokes.flows.named import Paraboloid, Shear
    from qbxstokes.flows.polynomial import PolynomialFlow
    from qbxstokes.motion import kernels, law
    from qbxstokes.motion.equations import RigidBodyEquations, pack_table
    from qbxstokes.petsc.stepper import integrate

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

    def whole_set_up(completion: Completion | None) -> Any:
        law = accurate_body(spheroid, 1e-10, strict=False, completion=completion).model.faxen
        return np.concatenate([[law.linear], law.quadratic, law.cubic])

    def model_of(n_phi: int, used: Scheme) -> Any:
        chosen = surface_operators(spheroid, used, n_phi)
        coefficients, _ = faxen_coefficients(modal_functional(chosen))
        return np.concatenate([coefficients.quadratic, coefficients.cubic])

    def motion(provider: Any) -> Any:
        return np.concatenate(provider.free_motion(0.0, x, q))

    def table_motion() -> Any:
        return np.concatenate(equations.velocities(0.0, state))

    def block(stokes_number: float, stream: float) -> Any:
        """Orientations at the end of a period; a stream too slow to count lets the bodies move."""
        moved = PolynomialFlow((stream, 0.0, 0.0), flow.gradient_tensor)
        many = RigidBodyEquations(model, moved, stokes_number, _BLOCK, evaluation="compiled")
        start = many.initial_state(np.zeros(3), orientations)
        return integrate(many, start, [jeffery.period(k)], 1e-8).states[-1, :, 3:7]

    def sphere(law: FaxenCoefficients) -> Callable[[], Any]:
        """Many right-hand sides; coefficients too small to count keep the axis in."""
        equations = RigidBodyEquations(replace(ball, faxen=law), Paraboloid(0.5))
        return many(equations.rate_of_rows, equations.initial_state((0.3, 2.0, 0.0), q[0]))

    def many(rate: Callable[[float, Any], Any], start: Any) -> Callable[[], Any]:
        rows = start[0].tolist()

        def calls() -> Any:
            for _ in range(_CALLS):
                result = rate(0.0, rows)
            return np.array(result)

        return calls

    def general(t: float, rows: Any) -> Any:
        arguments = [*rows, *constants, None, None]
        return kernels.massless(*arguments)

    ball = plain_body(Spheroid(1.0), scheme).model
    laws = (ball.faxen.quadratic, ball.faxen.cubic)
    orientations = rotation.random_quaternions(_BLOCK, np.random.default_rng(0))
    equations = RigidBodyEquations(model, flow)
    state = equations.initial_state(x[0], q[0])
    constants = law.tables(pack_table(flow, model).tolist())
    solve = SolveMotion(operators, flow)
    grid = GridMotion(functional.on_grid(8), flow)
    motion(solve)
    yield (
        "azimuthal modes above 1",
        lambda: model_of(8, scheme),
        lambda: model_of(3, scheme),
    )
    yield (
        "resistance where no force acts",
        lambda: whole_set_up("surface"),
        lambda: whole_set_up(None),
    )
    yield "outer expansions", lambda: model_of(3, both), lambda: model_of(3, scheme)
    yield (
        "rows that mirror symmetry gives",
        lambda: layer_rows(spheroid, scheme, 2, every)[0][: len(half)],
        lambda: layer_rows(spheroid, scheme, 2, half)[0],
    )
    yield "integral equation at a step", lambda: motion(solve), lambda: motion(grid)
    yield "flow on the surface at a step", lambda: motion(grid), table_motion
    yield (
        "terms that are zero at a right-hand side",
        many(general, state),
        many(equations.rate_of_rows, state),
    )
    yield (
        "axis of a sphere at a right-hand side",
        sphere(FaxenCoefficients(1e-300, *(np.maximum(c, 1e-300) for c in laws))),
        sphere(FaxenCoefficients(0.0, *laws)),
    )
    for stokes_number in (0.0, 10.0):
        for stream in (0.0, 1e-300):  # compile what a fresh machine has not
            block(stokes_number, stream)
        yield (
            f"translation at a stagnation point, a block of {_BLOCK}, St = {stokes_number:g}",
            partial(block, stokes_number, 1e-300),
            partial(block, stokes_number, 0.0),
        )
