"""What the studies of motion share: bodies, runs of blocks, averages in two windows of time.

Uncertainties. Every average comes from two runs whose tolerances differ by TOLERANCE_STEP and, in
the tighter one, from two windows of equal numbers of half-turns; the uncertainty is the larger of
the change with the tolerance and half the difference of the windows.

Transients. A run starts with the velocities of the massless body. What it does in the first
TRANSIENT slowest relaxation times St inertia/R, and in its first half-turn, is discarded.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.bie.accuracy import AccurateBody, accurate_body
from qbxstokes.bie.functional import BodyModel
from qbxstokes.flows import build_flow
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.cache import Cache, default_folder
from qbxstokes.motion.averages import ShearFrame, turn_averages
from qbxstokes.motion.equations import Inertia, RigidBodyEquations
from qbxstokes.motion.observables import observe
from qbxstokes.petsc.stepper import integrate
from qbxstokes.reference import heavy

Array = NDArray[np.float64]

MODEL_TOLERANCE = 1e-10
TOLERANCE = 1e-9
TOLERANCE_STEP = 30.0
TRANSIENT = 25.0
# Samples in one turn of a sphere; thin bodies flip faster, in a time of about min(k, 1/k).
_SAMPLES = 24


@lru_cache(maxsize=64)
def body(k: float) -> BodyModel:
    """The body model from the integral equation, kept between runs."""
    cache = Cache(default_folder())
    key = {"study": "motion", "aspect_ratio": k, "tolerance": MODEL_TOLERANCE, "degree": 2}
    arrays = cache.load("study", key)
    if arrays is not None:
        return AccurateBody.from_arrays(arrays).model
    made = accurate_body(Spheroid(k), MODEL_TOLERANCE, degree=2, strict=False)
    cache.store("study", key, made.to_arrays())
    return made.model


def polynomial(**spec: Any) -> PolynomialFlow:
    """A polynomial flow by its keys in the case file."""
    flow = build_flow(spec).polynomial
    assert flow is not None
    return flow


def shear() -> PolynomialFlow:
    """u = (x2, 0, 0)."""
    return polynomial(type="shear", rate=1.0)


def orientation(axis: Array) -> Array:
    """Quaternions (n, 4) with the axes (n, 3), exact in the plane of x1 and x2.

    There q0 = q1 and q2 = q3, which the motion keeps to the last bit: a body that tumbles in the
    plane of shear stays there even where tumbling is unstable.
    """
    q = rotation.from_axis(axis)
    flat = axis[:, 2] == 0.0
    half = 0.5 * np.arctan2(axis[flat, 0], -axis[flat, 1])
    c, s = np.cos(half), np.sin(half)
    q[flat] = np.stack([c, c, s, s], axis=-1) * math.sqrt(0.5)
    return q


def orbit_axes(k: float, constants: ArrayLike, phase: float = 0.0) -> Array:
    """Axes (n, 3) on Jeffery orbits of the given constants; infinite is tumbling."""
    c = np.atleast_1d(np.asarray(constants, dtype=float))
    part = np.where(np.isinf(c), 1.0, c)
    upright = np.where(np.isinf(c), 0.0, 1.0)
    d = np.stack([part * np.cos(phase), -k * part * np.sin(phase), upright], axis=-1)
    return np.asarray(d / np.linalg.norm(d, axis=-1, keepdims=True))


@dataclass(frozen=True)
class Run:
    """A block of bodies in time: quantities (T, n, 3) at times (T,), and its cost."""

    times: Array
    samples: dict[str, Array]
    steps: int
    evaluations: int
    method: str


def simulate(
    k: float,
    flow: PolynomialFlow,
    stokes_number: ArrayLike,
    axis: Array,
    times: Array,
    tolerance: float = TOLERANCE,
    position: ArrayLike = (0.0, 0.0, 0.0),
    inertia: Inertia = "both",
    wanted: Sequence[str] = (),
    **moving: Any,
) -> Run:
    """Integrate bodies that start with `axis` (n, 3); `moving`: velocity, angular_velocity."""
    n = len(axis)
    equations = RigidBodyEquations(
        body(k), flow, stokes_number, n, evaluation="compiled", inertia=inertia
    )
    start = equations.initial_state(position, orientation(axis), **moving)
    done = integrate(equations, start, times, tolerance, chunk_samples=len(times) + 1)
    samples = observe(equations, times, done.states, True, wanted)
    return Run(times, samples, done.steps, done.evaluations, done.method)


@dataclass(frozen=True)
class Measured:
    """Averages (n,) with their uncertainties (n,) by name, and how much they are taken over."""

    values: dict[str, Array]
    errors: dict[str, Array]
    half_turns: Array
    discarded: float


_AVERAGES = (
    "rotation_rate", "velocity_1", "velocity_2", "velocity_3", "orbit_drift", "position_2",
)  # fmt: skip


def measure(
    k: float,
    flow: PolynomialFlow,
    stokes_number: ArrayLike,
    axis: Array,
    half_turns: int,
    position: Sequence[float] = (0.0, 0.0, 0.0),
    inertia: Inertia = "both",
    relaxed: float | None = None,
    half_turn: float | None = None,
) -> Measured:
    """Averages over whole half-turns after the transient, by the rules above.

    values: rotation_rate, velocity_1 to _3 (means), orbit_drift (rate of ln C), position_2 (mean
    of the samples). relaxed: time that the transient takes, if it is not that of the slowest
    relaxation. half_turn: that of the slowest body, if it is not the one of tumbling.
    """
    stokes = np.broadcast_to(np.asarray(stokes_number, dtype=float), (len(axis),))
    gradient = flow.gradient(np.asarray(position, dtype=float))
    frame, rate = ShearFrame.of(gradient), float(np.linalg.norm(gradient))
    longest = math.pi * (k + 1.0 / k) / rate
    if float(np.min(stokes)) > 0.0 and inertia != "translation":
        # The half-turn of the lightest is the longest; heavy bodies take 2 pi at rate 1.
        longest = heavy.tumbling(k, float(np.min(stokes)) * rate).half_turn / rate
    longest = half_turn or longest
    if relaxed is None:
        relaxed = TRANSIENT * heavy.slowest_relaxation(k, float(np.max(stokes)))
    discard = relaxed + longest
    span = (half_turns + 0.5) * longest
    step = min(2.0 * math.pi / _SAMPLES, 0.6 * max(min(k, 1.0 / k), 0.02)) / rate
    times = np.concatenate([[0.0], discard + step * np.arange(math.ceil(span / step))])

    def averages(run: Run, window: slice) -> dict[str, Array]:
        late = {name: values[window] for name, values in run.samples.items()}
        found = turn_averages(run.times[window], late, k, frame)
        mean = {f"velocity_{i + 1}": found["mean_velocity"][:, i] for i in range(3)}
        found["rotation_rate"] = np.abs(found["rotation_rate"])
        return found | mean | {"position_2": late["position"][..., 1].mean(axis=0)}

    loose = simulate(k, flow, stokes, axis, times, TOLERANCE * TOLERANCE_STEP, position, inertia)
    tight = simulate(k, flow, stokes, axis, times, TOLERANCE, position, inertia)
    middle = len(times) // 2
    whole, other = averages(tight, slice(1, None)), averages(loose, slice(1, None))
    early, late = averages(tight, slice(1, middle + 1)), averages(tight, slice(middle, None))
    errors = {
        name: np.maximum(np.abs(whole[name] - other[name]), 0.5 * np.abs(late[name] - early[name]))
        for name in _AVERAGES
    }
    return Measured({name: whole[name] for name in _AVERAGES}, errors, whole["half_turns"], discard)


def decades(stokes_numbers: ArrayLike, group: float = 4.0) -> list[list[float]]:
    """Stokes numbers in increasing groups of like cost: within a factor of each other."""
    groups: list[list[float]] = []
    for value in sorted(np.asarray(stokes_numbers, dtype=float).tolist()):
        if groups and value <= group * groups[-1][0] * (1.0 + 1e-9):
            groups[-1].append(value)
        else:
            groups.append([value])
    return groups
