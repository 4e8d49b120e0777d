"""Integration of the equations of motion by PETSc TS.

`TS.step` takes one step at a time, so that sampling, events and checkpoints sit between the steps
and cost nothing inside them. The steps do not depend on the instants that are asked for.

Samples. A step from (t, y) to t + h is one application of the method's formula; the state at an
instant inside it is the same formula with a shorter step from the same (t, y), taken by a second
TS: as accurate as the steps, for the cost of one. PETSc's own interpolant serves where its order
suffices (`INTERPOLANT_SUFFICES`); it is linear for 8vr.

Tolerance. It is the error at the end of the run that the user accepts, in q and, relative to
max(1, |x|), in x. Both Runge-Kutta pairs propagate the formula of higher order and control the
lower one, which makes the global error proportional to the local tolerance; the factor is the
sensitivity of the equations (`RigidBodyEquations.sensitivity`), and the tolerance is divided by it.

The quaternion's length has no effect on the motion (kernels.py); it is set to 1 at every cut, where
a chunk of samples is handed over and a resumed run may start.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from petsc4py import PETSc

from qbxstokes.errors import ConvergenceError
from qbxstokes.geometry import rotation
from qbxstokes.motion.equations import RigidBodyEquations

Array = NDArray[np.float64]

# Smallest local tolerance: below it the error estimate is rounding.
FLOOR = 2e-15
# Formulas whose own interpolant is as good as the steps (measured, tests/test_stepper.py).
INTERPOLANT_SUFFICES = ("5dp", "bdf")
EXPLICIT_TYPES = ("rk",)
RK_FORMULAS = ("5dp", "8vr")
# A rate no step survives, small enough that sums of it stay finite.
OVERFLOWN = 1e100
REASONS = {-1: "the nonlinear solve failed", -2: "too many steps were rejected"}


@dataclass(frozen=True)
class Checkpoint:
    """All that a run needs to go on: time, states (n_bodies, n_state), next step, next sample."""

    time: float
    state: Array
    step: float
    next_sample: int
    steps: int
    rejections: int
    evaluations: int
    norm_drift: float


@dataclass(frozen=True)
class Chunk:
    """Samples since the last cut, and the checkpoint that follows them.

    times (c,); states (c, n_bodies, n_state), quaternions of unit length. `first` is the index of
    the first sample in the whole run.
    """

    first: int
    times: Array
    states: Array
    checkpoint: Checkpoint


@dataclass(frozen=True)
class Trajectory:
    """Samples and the record of the integration.

    times (T,), states (T, n_bodies, n_state); both empty when chunks were streamed instead.
    norm_drift: largest | |q| - 1 | that any cut met before it was removed.
    local_tolerance: what the error of a step was held to. finished: False if `interrupted` said
    stop.
    """

    times: Array
    states: Array
    checkpoint: Checkpoint
    method: str
    local_tolerance: float
    finished: bool
    reason: str
    jacobians: int = 0

    @property
    def steps(self) -> int:
        """Accepted steps."""
        return self.checkpoint.steps

    @property
    def rejections(self) -> int:
        """Rejected steps."""
        return self.checkpoint.rejections

    @property
    def evaluations(self) -> int:
        """Right-hand sides of the block."""
        return self.checkpoint.evaluations

    @property
    def norm_drift(self) -> float:
        """Largest deviation of |q| from 1 before it was removed."""
        return self.checkpoint.norm_drift


@dataclass
class _Counter:
    evaluations: int = 0
    jacobians: int = 0
    failure: BaseException | None = field(default=None)


def integrate(
    equations: RigidBodyEquations,
    start: ArrayLike | Checkpoint,
    times: ArrayLike,
    tolerance: float = 1e-10,
    *,
    t0: float = 0.0,
    method: str | None = None,
    prefix: str = "",
    on_chunk: Callable[[Chunk], None] | None = None,
    chunk_samples: int = 1000,
    chunk_steps: int = 10_000,
    interrupted: Callable[[], bool] | None = None,
) -> Trajectory:
    """States at increasing `times` of the motion that starts from `start` at t0.

    start: states (n_bodies, n_state), or the checkpoint of an interrupted run with the same other
    arguments, which then ends with the same numbers. tolerance: error accepted at the end.
    method: "5dp", "8vr", "rosw", "arkimex" or "bdf"; None chooses, options `-ts_*` with `prefix`
    override it.
    on_chunk receives the samples in pieces of about `chunk_samples` (and at least every
    `chunk_steps` steps a piece, possibly without samples) and they are not kept.
    Raises ConvergenceError when a step cannot be completed.
    """
    instants = np.asarray(times, dtype=np.float64)
    if isinstance(start, Checkpoint):
        checkpoint = start
    else:
        state = np.array(start, dtype=np.float64).reshape(equations.n_bodies, equations.n_state)
        checkpoint = Checkpoint(t0, state, 0.0, 0, 0, 0, 0, 0.0)
    run = _Run(equations, checkpoint, instants, tolerance, method, prefix)
    kept: list[Chunk] = []
    finished = run.go(on_chunk or kept.append, chunk_samples, chunk_steps, interrupted)
    shape = (0, equations.n_bodies, equations.n_state)
    return Trajectory(
        times=np.concatenate([np.empty(0), *(chunk.times for chunk in kept)]),
        states=np.concatenate([np.empty(shape), *(chunk.states for chunk in kept)]),
        checkpoint=run.checkpoint,
        method=run.method,
        local_tolerance=run.local_tolerance,
        finished=finished,
        reason="reached the end" if finished else "interrupted",
        jacobians=run.counter.jacobians,
    )


class _Run:
    """One integration in progress."""

    def __init__(
        self,
        equations: RigidBodyEquations,
        checkpoint: Checkpoint,
        times: Array,
        tolerance: float,
        method: str | None,
        prefix: str,
    ) -> None:
        self.equations, self.checkpoint, self.times = equations, checkpoint, times
        self.counter = _Counter(checkpoint.evaluations)
        self._prefix = prefix
        self._end = float(times[-1])
        horizon = self._end - checkpoint.time
        sensitivity = equations.sensitivity(checkpoint.time, checkpoint.state, horizon)
        self.local_tolerance = max(tolerance / sensitivity, FLOOR)
        self._scales = equations.scales(checkpoint.time, checkpoint.state)
        self._wanted = method or ("5dp" if self.local_tolerance > 1e-6 else "8vr")
        self._expected = 1e3
        database = PETSc.Options()
        self._monitored = any(name.startswith(f"{prefix}ts_monitor") for name in database.getAll())
        self._build()

    # -- PETSc ------------------------------------------------------------------------------

    def _build(self) -> None:
        """Fresh integrators at the checkpoint: a resumed run passes through the same code."""
        self._vector = PETSc.Vec().createSeq(self.checkpoint.state.size)
        self._ts = self._integrator(self._vector, adaptive=True)
        kind = str(self._ts.getType())
        self.method = str(self._ts.getRKType()) if kind == "rk" else kind
        self._inner = self._vector.duplicate()
        self._sampler: Any = None
        self._write(self._vector, self.checkpoint.state)
        self._ts.setTime(self.checkpoint.time)
        self._ts.setStepNumber(self.checkpoint.steps)
        self._ts.setTimeStep(self.checkpoint.step or self._first_step())
        self._ts.setMaxTime(self._end)

    def _integrator(self, vector: Any, adaptive: bool) -> Any:
        """A TS of the wanted type with its callbacks, as defaults below the options."""
        ts = PETSc.TS().create(PETSc.COMM_SELF)
        ts.setOptionsPrefix(self._prefix)
        if self._wanted in RK_FORMULAS:
            ts.setType("rk")
            ts.setRKType(self._wanted)
        else:
            ts.setType(self._wanted)
        ts.setMaxSteps(2**31 - 1)
        ts.setMaxTime(self._end)
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.MATCHSTEP)
        ts.setErrorIfStepFails(False)
        ts.setMaxStepRejections(100)
        defaults = {"ts_adapt_wnormtype": "infinity"}
        if not adaptive:
            defaults["ts_adapt_type"] = "none"
        with _Defaults(self._prefix, defaults, override=not adaptive):
            ts.setFromOptions()
        ts.setRHSFunction(self._rate_callback(), vector.duplicate())
        if ts.getType() not in EXPLICIT_TYPES:
            raise NotImplementedError
        weights = vector.duplicate()
        self._write(weights, self.local_tolerance * self._scales)
        ts.setTolerances(rtol=self.local_tolerance, atol=weights)
        ts.setSolution(vector)
        return ts

    def _rate_callback(self) -> Callable[[Any, float, Any, Any], None]:
        counter, equations = self.counter, self.equations

        if equations.n_bodies == 1 and not equations.compiled(self._expected):
            single = equations.rate_of_rows

            def callback(ts: Any, t: float, state: Any, rate: Any) -> None:
                counter.evaluations += 1
                try:
                    rate.setArray(single(t, state.getArray(readonly=1).tolist()))
                except (ZeroDivisionError, OverflowError):
                    rate.set(OVERFLOWN)  # a stage far off: the error estimate rejects the step
                except BaseException as failure:
                    counter.failure = failure
                    raise

            return callback

        function = equations.rate_function(self._expected)
        shape = (equations.n_state, equations.n_bodies)
        out = np.empty(shape)

        def callback_block(ts: Any, t: float, state: Any, rate: Any) -> None:
            counter.evaluations += 1
            try:
                function(t, state.getArray(readonly=1).reshape(shape), out)
                rate.setArray(out)
            except BaseException as failure:
                counter.failure = failure
                raise

        return callback_block

    def _write(self, vector: Any, states: Array) -> None:
        vector.setArray(np.ascontiguousarray(states.T))

    def _read(self, vector: Any) -> Array:
        values = vector.getArray(readonly=1)
        equations = self.equations
        return np.array(values.reshape(equations.n_state, equations.n_bodies).T)

    def _first_step(self) -> float:
        """A step over which nothing moves by more than a tenth of its scale."""
        equations, checkpoint = self.equations, self.checkpoint
        state = np.ascontiguousarray(checkpoint.state.T)
        rate = np.empty_like(state)
        equations.rates(checkpoint.time, state, rate)
        size = self._scales.T + np.abs(state)
        fastest = max(float(np.max(np.abs(rate) / size)), float(np.max(self.equations.stiffness)))
        span = self._end - checkpoint.time
        return min(span, 0.1 / fastest) if fastest > 0.0 else span

    # -- the run ----------------------------------------------------------------------------

    def go(
        self,
        deliver: Callable[[Chunk], None],
        chunk_samples: int,
        chunk_steps: int,
        interrupted: Callable[[], bool] | None,
    ) -> bool:
        """Step to the end; False if `interrupted` stopped it at the last cut."""
        ts, times = self._ts, self.times
        index, t = self.checkpoint.next_sample, self.checkpoint.time
        samples: list[Array] = []
        while index < len(times) and times[index] <= t:
            samples.append(self._sample(self._read(self._vector)))
            index += 1
        cut = self.checkpoint.steps + chunk_steps
        while index < len(times):
            if interrupted is not None and interrupted():
                return False
            before, start = t, self._vector.getArray(readonly=1).copy()
            self._step()
            t = self._end if _reached(ts.getTime(), self._end) else ts.getTime()
            while index < len(times) and times[index] <= t:
                samples.append(self._sample(self._state_at(before, start, t, times[index])))
                index += 1
            if len(samples) >= chunk_samples or ts.getStepNumber() >= cut or index == len(times):
                self._cut(deliver, t, index, samples)
                ts, samples = self._ts, []
                cut = self.checkpoint.steps + chunk_steps
        if samples:
            self._cut(deliver, t, index, samples)
        return True

    def _step(self) -> None:
        """One accepted step; every way it can fail ends in a ConvergenceError."""
        ts = self._ts
        try:
            ts.step()
        except PETSc.Error as error:
            failure = self.counter.failure
            if failure is not None:
                raise failure from error
            raise self._failed(str(error).strip().splitlines()[-1]) from error
        reason = ts.getConvergedReason()
        if reason < 0:
            raise self._failed(REASONS.get(reason, f"reason {reason}"))
        if ts.getStepNumber() >= ts.getMaxSteps():
            raise self._failed("the largest number of steps (-ts_max_steps) is taken")
        if self._monitored:
            ts.monitor(ts.getStepNumber(), ts.getTime(), self._vector)

    def _failed(self, what: str) -> ConvergenceError:
        ts = self._ts
        return ConvergenceError(
            f"time integration ({self.method}) stopped at t = {ts.getTime():.6g}, step "
            f"{ts.getStepNumber()} with step size {ts.getTimeStep():.3g}: {what}. Try a larger "
            "tolerance, another -ts_type (implicit ones: arkimex, rosw, bdf) or -ts_adapt_monitor "
            "to see why steps are rejected"
        )

    def _state_at(self, before: float, start: Array, after: float, t: float) -> Array:
        """State at t in [before, after], where `start` is the vector at `before`."""
        if t == after:
            return self._read(self._vector)
        if self.method in INTERPOLANT_SUFFICES:
            self._ts.interpolate(t, self._inner)
            return self._read(self._inner)
        if self._sampler is None:
            self._sampler = self._integrator(self._inner, adaptive=False)
        sampler = self._sampler
        self._inner.setArray(start)
        sampler.setTime(before)
        sampler.setTimeStep(t - before)
        sampler.setMaxTime(2.0 * after - before)
        sampler.restartStep()
        sampler.step()
        return self._read(self._inner)

    def _sample(self, state: Array) -> Array:
        state[:, 3:7] = rotation.normalize(state[:, 3:7])
        return state

    def _cut(
        self, deliver: Callable[[Chunk], None], t: float, index: int, samples: list[Array]
    ) -> None:
        """Hand over the samples with a checkpoint, and start afresh from it."""
        ts = self._ts
        state = self._read(self._vector)
        drift = float(np.max(np.abs(np.linalg.norm(state[:, 3:7], axis=1) - 1.0)))
        old = self.checkpoint
        self.checkpoint = Checkpoint(
            time=t,
            state=self._sample(state),
            step=float(ts.getTimeStep()),
            next_sample=index,
            steps=ts.getStepNumber(),
            rejections=old.rejections + ts.getStepRejections(),
            evaluations=self.counter.evaluations,
            norm_drift=max(old.norm_drift, drift),
        )
        first = index - len(samples)
        shape = (len(samples), *state.shape)
        chunk = Chunk(
            first, self.times[first:index], np.array(samples).reshape(shape), self.checkpoint
        )
        deliver(chunk)
        if index < len(self.times):
            self._build()


def _reached(t: float, end: float) -> bool:
    return t >= end or math.isclose(t, end, rel_tol=1e-14)


class _Defaults:
    """Options that hold while an object reads its own, unless the user has set them."""

    def __init__(self, prefix: str, options: dict[str, str], override: bool = False) -> None:
        self._options = {prefix + name: value for name, value in options.items()}
        self._override = override

    def __enter__(self) -> None:
        database = PETSc.Options()
        self._before = {
            name: database.getString(name) if database.hasName(name) else None
            for name in self._options
        }
        for name, value in self._options.items():
            if self._override or self._before[name] is None:
                database.setValue(name, value)

    def __exit__(self, *_: object) -> None:
        database = PETSc.Options()
        for name, value in self._before.items():
            database.delValue(name)
            if value is not None:
                database.setValue(name, value)
