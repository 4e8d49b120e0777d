"""How every cost grows: exponents of time (ms) over size, fitted and expected.

Run:      python cases/benchmarks/scaling.py      (1 min; --small: 5 s; --csv)
Expected: exponents at most the expected ones, which hold for large sizes; one below it shows a cost
          that does not grow beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from measure import Rows, command, seconds_each, shown

from qbxstokes.bie.exact import exact_model
from qbxstokes.bie.field import resistance_disturbance
from qbxstokes.bie.operators import surface_operators
from qbxstokes.flows.named import Shear
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.qbx.operator import GradedScheme, layer_rows

BODY = Spheroid(0.5)


def row(n_theta: int = 8, order: int = 10, n_modes: int = 2) -> Callable[[], Any]:
    """A row of the operator: panels shorten with the nodes, and each interpolates from all."""
    return partial(layer_rows, BODY, GradedScheme(n_theta, order, 0.3, 10), n_modes, [0])


def application(n_theta: int) -> Callable[[], Any]:
    """The operator on a density: a dense block per mode; more once it leaves the cache."""
    operator = surface_operators(BODY, GradedScheme(n_theta, 8, 0.3, 6), 8).mobility
    return partial(operator.apply, np.random.default_rng(0).standard_normal((8 * n_theta, 3)))


def block(bodies: int) -> Callable[[], Any]:
    """Right-hand sides of independent bodies in a shear."""
    equations = RigidBodyEquations(exact_model(0.5), Shear(), 0.0, bodies, evaluation="compiled")
    state = np.ascontiguousarray(equations.initial_state(np.zeros(3), [0.5, 0.5, 0.5, 0.5]).T)
    return partial(equations.rate_function(), 0.0, state, np.empty((7, bodies)))


def targets(count: int) -> Callable[[], Any]:
    """Independent points around a translating body."""
    operators = surface_operators(BODY, GradedScheme(8, 10, 0.3, 12), 6)
    wind = np.array([1.0, 0.0, 0.0])
    around = resistance_disturbance(operators, np.zeros_like, wind, np.zeros(3), degree=0)
    rng = np.random.default_rng(0)
    points = rotation.random_axes(count, rng) * rng.uniform(1.5, 8.0, (count, 1))
    return partial(around.evaluate, points, 1e-8)


# What grows with what: sizes (small, full) and the exponent for large ones.
GROWTHS: dict[str, tuple[tuple[int, ...], tuple[int, ...], float, Callable[[int], Any]]] = {
    "row, n_theta": ((8, 16), (128, 256, 512), 2.0, lambda n: row(n_theta=n)),
    "row, order p": ((8, 32), (80, 160, 320, 640), 1.0, lambda p: row(order=p)),
    "row, modes": ((2, 8), (8, 16, 32, 64), 1.0, lambda m: row(n_modes=m)),
    "operator, n_theta": ((8, 16), (32, 64, 128), 2.0, application),
    "right-hand side, bodies": ((64, 1024), (1024, 4096, 16384, 65536), 1.0, block),
    "field, targets": ((100, 1000), (1000, 4000, 16000, 64000), 1.0, targets),
}


def main(small: bool = False) -> dict[str, Rows]:
    """A row per growth."""
    rows: Rows = []
    for what, (few, many, expected, make) in GROWTHS.items():
        sizes = few if small else many
        spans = [1e3 * seconds_each(make(size), 1 if small else 5) for size in sizes]
        exponent = float(np.polyfit(np.log(sizes), np.log(spans), 1)[0])
        row = {"what": what, "exponent": exponent, "expected": expected}
        row |= {"sizes": " ".join(map(str, sizes)), "times": " ".join(map(shown, spans))}
        rows.append(row)
    return {"scaling": rows}


if __name__ == "__main__":
    command(main)
