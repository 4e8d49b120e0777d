"""How every cost grows: exponents of time over size, fitted and expected.

    python cases/benchmarks/scaling.py [--small] [--csv]

1 min. Expected: exponents at most the expected ones, which hold for large sizes; one below it shows
a cost that does not grow beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from measure import Rows, command, seconds_each

from qbxstokes.bie.exact import exact_model
from qbxstokes.bie.field import resistance_disturbance
from qbxstokes.bie.operators import surface_operators
from qbxstokes.flows.named import Shear
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.qbx.operator import GradedScheme, layer_rows

BODY = Spheroid(0.5)


def row(n_theta: int = 8, order: int = 10, n_modes: int = 2) -> Callable[[], Any]:
    """A row of the operator."""
    scheme = GradedScheme(n_theta, order, 0.3, 10)
    return lambda: layer_rows(BODY, scheme, n_modes, [0])


def application(n_theta: int) -> Callable[[], Any]:
    """The operator on a density."""
    operator = surface_operators(BODY, GradedScheme(n_theta, 8, 0.3, 6), 8).mobility
    field = np.random.default_rng(0).standard_normal((8 * n_theta, 3))
    return lambda: operator.apply(field)


def block(bodies: int) -> Callable[[], Any]:
    """Right-hand sides of bodies in a shear."""
    equations = RigidBodyEquations(exact_model(0.5), Shear(), 0.0, bodies, evaluation="compiled")
    state = np.ascontiguousarray(equations.initial_state(np.zeros(3), [0.5, 0.5, 0.5, 0.5]).T)
    rate, out = equations.rate_function(), np.empty((7, bodies))
    return lambda: rate(0.0, state, out)


def targets(count: int) -> Callable[[], Any]:
    """Points around a translating body."""
    operators = surface_operators(BODY, GradedScheme(8, 10, 0.3, 12), 6)
    wind = np.array([1.0, 0.0, 0.0])
    around = resistance_disturbance(operators, np.zeros_like, wind, np.zeros(3), degree=0)
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    points = directions * rng.uniform(1.5, 8.0, (count, 1))
    return lambda: around.evaluate(points, 1e-8)


# What, over which parameter, sizes (small, full), exponent for large sizes and its reason.
GROWTHS: tuple[tuple[Any, ...], ...] = (
    ("row of the operator", "n_theta", (8, 16), (128, 256, 512), 2.0,
     "panels shorten with the nodes, each interpolates from all", lambda n: row(n_theta=n)),
    ("row of the operator", "order p", (8, 32), (80, 160, 320, 640), 1.0,
     "recurrences of length p", lambda p: row(order=p)),
    ("row of the operator", "modes", (2, 8), (8, 16, 32, 64), 1.0,
     "a Fourier sum each", lambda m: row(n_modes=m)),
    ("operator on a density", "n_theta", (8, 16), (32, 64, 128), 2.0,
     "a dense block per mode; more once it leaves the cache", application),
    ("right-hand side", "bodies", (64, 1024), (1024, 4096, 16384, 65536), 1.0,
     "bodies are independent", block),
    ("field", "targets", (100, 1000), (1000, 4000, 16000, 64000), 1.0,
     "targets are independent", targets),
)  # fmt: skip


def measured(small: bool) -> Iterator[tuple[dict[str, Any], Rows]]:
    """The fit of every growth, and its times (ms)."""
    for what, parameter, few, many, expected, reason, make in GROWTHS:
        sizes = few if small else many
        spans = [seconds_each(make(size), 1 if small else 5) for size in sizes]
        exponent = float(np.polyfit(np.log(sizes), np.log(spans), 1)[0])
        key = {"what": what, "parameter": parameter}
        fit = {"sizes": f"{sizes[0]} to {sizes[-1]}", "exponent": exponent}
        times = [
            key | {"size": size, "time": 1e3 * span, "ratio": span / spans[0]}
            for size, span in zip(sizes, spans, strict=True)
        ]
        yield key | fit | {"expected": expected, "reason": reason}, times


def main(small: bool = False) -> dict[str, Rows]:
    """Exponents, and the times they are fitted to."""
    fits, times = zip(*measured(small), strict=True)
    return {"scaling": list(fits), "scaling_times": [row for rows in times for row in rows]}


if __name__ == "__main__":
    command(main)
