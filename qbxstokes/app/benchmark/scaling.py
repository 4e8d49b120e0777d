"""How cost grows with nodes, order, modes, bodies and targets: exponents beside expected ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.app.benchmark.timing import seconds_each
from qbxstokes.bie.field import resistance_disturbance
from qbxstokes.bie.operators import form_body_model, surface_operators
from qbxstokes.flows.named import Shear
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.qbx.operator import GradedScheme, layer_rows

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work

_BODY = Spheroid(0.5)


@dataclass(frozen=True)
class Growth:
    """What is measured over which sizes, and the exponent to be expected.

    expected: for sizes large enough; smaller ones also pay what does not grow.
    """

    what: str
    parameter: str
    sizes: Sequence[int]
    expected: float
    reason: str
    make: Callable[[int], Callable[[], Any]]


def _row(n_theta: int = 8, order: int = 10, n_modes: int = 2) -> Callable[[], Any]:
    scheme = GradedScheme(n_theta, order, 0.3, 10)
    return lambda: layer_rows(_BODY, scheme, n_modes, [0])


def _apply(n_theta: int) -> Callable[[], Any]:
    operator = surface_operators(_BODY, GradedScheme(n_theta, 8, 0.3, 6), 8).mobility
    field = np.random.default_rng(0).standard_normal((8 * n_theta, 3))
    return lambda: operator.apply(field)


def _block(bodies: int) -> Callable[[], Any]:
    model = form_body_model(surface_operators(_BODY, GradedScheme(6, 8, 0.3, 12)))
    equations = RigidBodyEquations(model, Shear(), 0.0, bodies, evaluation="compiled")
    state = np.ascontiguousarray(equations.initial_state(np.zeros(3), [0.5, 0.5, 0.5, 0.5]).T)
    rate, out = equations.rate_function(), np.empty((7, bodies))
    return lambda: rate(0.0, state, out)


def _targets(count: int) -> Callable[[], Any]:
    operators = surface_operators(_BODY, GradedScheme(8, 10, 0.3, 12), 6)
    around = resistance_disturbance(
        operators, lambda x: np.zeros_like(x), np.array([1.0, 0.0, 0.0]), np.zeros(3), degree=0
    )
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    points = directions * rng.uniform(1.5, 8.0, (count, 1))
    return lambda: around.evaluate(points, 1e-8)


def growths(work: Work) -> Iterator[Growth]:
    """The measurements, small or full."""
    row, sizes = "row of the operator", work.choose
    yield Growth(
        row,
        "n_theta",
        sizes((8, 16), (128, 256, 512)),
        2.0,
        "panels shorten with the nodes, each interpolates from all",
        lambda n: _row(n_theta=n),
    )
    yield Growth(
        row,
        "order p",
        sizes((8, 32), (80, 160, 320, 640)),
        1.0,
        "recurrences of length p",
        lambda p: _row(order=p),
    )
    yield Growth(
        row,
        "modes",
        sizes((2, 8), (8, 16, 32, 64)),
        1.0,
        "a Fourier sum each",
        lambda m: _row(n_modes=m),
    )
    yield Growth(
        "operator on a density",
        "n_theta",
        sizes((8, 16), (32, 64, 128)),
        2.0,
        "a dense block per mode; more once it leaves the cache",
        _apply,
    )
    yield Growth(
        "right-hand side",
        "bodies",
        sizes((64, 1024), (1024, 4096, 16384, 65536)),
        1.0,
        "bodies are independent",
        _block,
    )
    yield Growth(
        "field",
        "targets",
        sizes((100, 1000), (1000, 4000, 16000, 64000)),
        1.0,
        "targets are independent",
        _targets,
    )


def tables(work: Work) -> Iterator[Table]:
    """Times over sizes, and the exponents fitted to them."""
    times = Table(
        "scaling_times",
        "Scaling: times",
        (
            Column("what"),
            Column("parameter"),
            Column("size", "", "", "d"),
            Column("time", "ms", "median wall time", ".3g"),
            Column("ratio", "", "over the smallest size", ".3g"),
        ),
        plot={"x": "size", "y": "time", "by": ["what", "parameter"], "scale": "loglog"},
    )
    fits = Table(
        "scaling",
        "Scaling: exponent of the time, fitted and expected",
        (
            Column("what"),
            Column("parameter"),
            Column("smallest", "", "", "d"),
            Column("largest", "", "", "d"),
            Column("exponent", "", "least squares in logarithms", ".2f"),
            Column("expected", "", "for large sizes", ".1f"),
            Column("reason", "", "of the expectation"),
        ),
        notes=["An exponent below the expected one shows a cost that does not grow beside it."],
    )
    repeats = work.choose(1, work.section.repeats)
    for growth in growths(work):
        work.say(f"{growth.what} over {growth.parameter}")
        spans = [seconds_each(growth.make(size), repeats) for size in growth.sizes]
        for size, span in zip(growth.sizes, spans, strict=True):
            key = {"what": growth.what, "parameter": growth.parameter}
            times.add(**key, size=size, time=1e3 * span, ratio=span / spans[0])
        exponent = float(np.polyfit(np.log(growth.sizes), np.log(spans), 1)[0])
        fits.add(
            what=growth.what,
            parameter=growth.parameter,
            smallest=growth.sizes[0],
            largest=growth.sizes[-1],
            exponent=exponent,
            expected=growth.expected,
            reason=growth.reason,
        )
    yield fits
    yield times
