"""Integration of the equations of motion by PETSc TS.

`TS.step` takes one step at a time, so that sampling, events and checkpoints sit between the steps
and cost nothing inside them. The steps do not depend on the instants that are asked for.

Events are found by an observer between the steps, as roots of functions of the states inside a step
(below), and not by TSSetEventHandler. That one ends a step at each event and starts the next one
afresh, so that the motion would depend on what is watched for; it acts within TSSolve alone, which
leaves no place for cuts; and how well an instant is known depends on the size of the function's
values near it. Table `events` of `cases/benchmark_motion.yaml` compares both. At the tolerance of
the motion they find half-turns equally well, for 18 % (here) and 26 % (there) more right-hand sides
of 8vr at St = 0, 1 % at St = 1, and none (here) and 8 % (there) of BDF; but with PETSc's own
tolerance for events the instants err by 1e-7 to 1e-6 in a motion good to 1e-8, and with a fine one
BDF begins anew at low order so often that its error grows from 2e-8 to 5e-5. The functions found
between the steps leave the motion as it is, to the last bit.

Samples. A step from (t, y) to t + h is one application of the method's formula; the state at an
instant inside it is the same formula with a shorter step from the same (t, y), taken by a second
TS: as accurate as the steps, for the cost of one. PETSc's own interpolant serves where its order
suffices (`INTERPOLANT_SUFFICES`); it is linear for 8vr. Where more than `FEW` states are wanted of
one step, two are made so, at its thirds, and the rest follow from the polynomial of degree 7 that
has the states and rates of the ends and the thirds. With a radius of convergence r of the motion it
errs by 1.5e-4 (h/r)^8 at most, about what the step does: 30 right-hand sides, however many states.

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

from qbxstokes.errors import ConvergenceError, FlowError, FlowFunctionError
from qbxstokes.geometry import rotation
from qbxstokes.motion.centred import CentredEquations
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.forecast import EXPLICIT_TYPES, STAGES, Forecast
from qbxstokes.petsc.session import temporary_options
from qbxstokes.petsc.trajectory import Checkpoint, Chunk, Step, Trajectory

Array = NDArray[np.float64]

# Formulas whose own interpolant is as good as the steps (measured, tests/test_stepper.py).
INTERPOLANT_SUFFICES = ("5dp", "bdf")
RK_FORMULAS = ("5dp", "8vr")
# States inside one step up to which each is made by the method's formula.
FEW = 2
# Fewest steps of BDF between two cuts, unless so many samples wait.
BDF_STEPS = 1000
BDF_SAMPLES = 20_000
# Share of the longest step below which a step with a stage that has no value is given up.
SHORTEST = 1e-4
REASONS = {-1: "the nonlinear solve failed", -2: "too many steps were rejected"}
NO_VALUE = "the rates of change have no finite value further on, however short the step"
NO_BOUND = "the rates of change grow without bound"
ADVICE = (
    ". Try a larger tolerance, another -ts_type (implicit ones: arkimex, rosw, bdf) or "
    "-ts_adapt_monitor to see why steps are rejected"
)


@dataclass
class _Counter:
    evaluations: int = 0
    jacobians: int = 0
    failure: BaseException | None = field(default=None)
    refusal: FlowError | None = None  # what the flow said of the last stage it had no value for
    astray: bool = False  # a stage of the present step was where the rate has no value


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
    chunk_time: float = math.inf,
    interrupted: Callable[[], bool] | None = None,
    observe: Callable[[Step], float | None] | None = None,
    longest_step: float | None = None,
) -> Trajectory:
    """States at increasing `times` of the motion that starts from `start` at t0.

    start: states (n_bodies, n_state), or the checkpoint of an interrupted run with the same other
    arguments, which then ends with the same numbers. tolerance: error accepted at the end.
    method: "5dp", "8vr", "rosw", "arkimex" or "bdf"; None chooses, options `-ts_*` with `prefix`
    override it.
    on_chunk receives the samples in pieces of about `chunk_samples` (and at least every
    `chunk_steps` steps or `chunk_time` a piece, possibly without samples) and they are not kept;
    a piece of a BDF run is longer where it would have fewer than `BDF_STEPS` steps.
    observe is called after every step and may return an instant of it at which the run ends; with
    it, a step that cannot be completed ends the run (`refusal`, `failure`) instead of failing it.
    longest_step: bound on the steps, for loads that the start tells nothing about.
    Raises ConvergenceError, or what the flow raised, when a step cannot be completed.
    """
    instants = np.asarray(times, dtype=np.float64)
    if isinstance(start, Checkpoint):
        checkpoint = start
    else:
        state = np.array(start, dtype=np.float64).reshape(equations.n_bodies, equations.n_state)
        checkpoint = Checkpoint(t0, state)
    run = Run(equations, checkpoint, instants, tolerance, method, prefix, longest_step)
    kept: list[Chunk] = []
    limits = chunk_samples, chunk_steps, chunk_time
    try:
        finished = run.go(on_chunk or kept.append, limits, interrupted, observe)
    finally:
        run.release()
    shape = (0, equations.n_bodies, equations.n_state)
    return Trajectory(
        times=np.concatenate([np.empty(0), *(chunk.times for chunk in kept)]),
        states=np.concatenate([np.empty(shape), *(chunk.states for chunk in kept)]),
        checkpoint=run.checkpoint,
        finished=finished,
        stopped=run.stopped,
        refusal=run.refusal,
        failure=run.failure,
    )


class Run:
    """One integration in progress."""

    def __init__(
        self,
        equations: RigidBodyEquations,
        checkpoint: Checkpoint,
        times: Array,
        tolerance: float,
        method: str | None,
        prefix: str,
        longest_step: float | None,
    ) -> None:
        self.equations, self.checkpoint, self.times = equations, checkpoint, times
        self.stopped, self.refusal, self.failure, self._longest = False, "", "", longest_step
        self._largest = 0.0
        # What is integrated: the rotation alone where no centre can move. Compiled blocks take 1.2
        # to 2 times less then; with the plain kernels neither one body nor several gain anything.
        self._moving: RigidBodyEquations | CentredEquations = equations
        if equations.compiled() and equations.at_rest(checkpoint.state):
            self._moving = CentredEquations(equations, checkpoint.state)
        self.counter = _Counter(checkpoint.evaluations, checkpoint.jacobians)
        self._prefix, self._end = prefix, float(times[-1])
        self._guide = Forecast(equations, checkpoint.time, checkpoint.state, self._end, tolerance)
        self._wanted = checkpoint.method or method or self._guide.method
        self._native: Any = None
        database = PETSc.Options()
        self._monitored = any(name.startswith(f"{prefix}ts_monitor") for name in database.getAll())
        self._inside: tuple[float, Array] | None = None
        self.ts: Any = None
        self._sampler: Any = None
        self._build()

    # -- PETSc ------------------------------------------------------------------------------

    def _build(self) -> None:
        """Fresh integrators at the checkpoint: a resumed run passes through the same code."""
        start = self.checkpoint
        self._scales = self.equations.scales(start.time, start.state)
        self.release()
        self._vector = PETSc.Vec().createSeq(self._moving.n_bodies * self._moving.n_state)
        self._inner = self._vector.duplicate()
        self.ts = self._integrator(self._vector, adaptive=True)
        self._write(self._vector, start.state)
        self.ts.setTime(start.time)
        self.ts.setStepNumber(start.steps)
        self.ts.setTimeStep(start.step or self._first_step())

    def release(self) -> None:
        """Free the integrators: they hold callbacks that hold this object, unseen by Python."""
        for integrator in (self.ts, self._sampler):
            if integrator is not None:
                integrator.destroy()
        self.ts = self._sampler = None

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
        # The Newton solver inside has the prefix ts_, apart from the solver of integral equations.
        ts.getSNES().setOptionsPrefix(f"{self._prefix}ts_")
        defaults = {
            "ts_adapt_wnormtype": "infinity",
            **({"ts_adapt_dt_max": repr(self._longest)} if self._longest else {}),
            "ts_arkimex_type": "5",
            "ts_bdf_order": "6",
            "ts_snes_linesearch_type": "basic",
            "ts_ksp_type": "preonly",
            "ts_pc_type": "lu" if self.equations.n_bodies == 1 else "pbjacobi",
        }
        forced = {} if adaptive else {"ts_adapt_type": "none"}
        with temporary_options(self._prefix, defaults, forced):
            ts.setFromOptions()
        kind = str(ts.getType())
        self._bodywise = kind not in EXPLICIT_TYPES
        self.method = str(ts.getRKType()) if kind == "rk" else kind
        self.local_tolerance = self.checkpoint.local_tolerance or self._guide.tolerance(kind)
        self.reachable = self.checkpoint.reachable or self._guide.reachable(kind)
        self._expected = self._guide.evaluations(kind) + STAGES * len(self.times)
        self._rate = self._rate_callback()
        if self._bodywise:
            self._set_implicit(ts, self._rate, vector)
        elif (native := self._native_rate()) is not None:
            native.give(ts, vector.duplicate())
        else:
            ts.setRHSFunction(self._rate, vector.duplicate())
        weights = vector.duplicate()
        self._write(weights, self.local_tolerance * self._scales)
        ts.setTolerances(rtol=self.local_tolerance, atol=weights)
        ts.setSolution(vector)
        self._most_steps = ts.getMaxSteps()
        return ts

    def _native_rate(self) -> Any:
        """The compiled rate as a C function, one for all integrators of the run, or None."""
        if self._native is None:
            block = self._moving.block_constants(self._expected)
            if block is not None:
                from qbxstokes.petsc.native import native_rate

                self._native = native_rate(block, self.equations.n_bodies)
        return self._native

    def _rate_callback(self) -> Callable[[Any, float, Any, Any], None]:
        counter, equations = self.counter, self.equations

        if equations.n_bodies == 1 and not equations.compiled(self._expected):
            single = equations.rate_of_rows

            def callback(ts: Any, t: float, state: Any, rate: Any) -> None:
                counter.evaluations += 1
                try:
                    values = single(t, state.getArray(readonly=1).tolist())
                    if not math.isfinite(sum(values)):
                        raise OverflowError
                    rate.setArray(values)
                except (ArithmeticError, ValueError):  # a state beyond all bounds, or no rates
                    counter.refusal, counter.astray = None, True
                    rate.set(0.0)  # whatever comes of it is taken back
                except FlowError as refusal:
                    counter.refusal, counter.astray = refusal, True
                    rate.set(0.0)
                except BaseException as failure:
                    counter.failure = failure
                    raise

            return callback

        function = self._moving.rate_function(self._expected)
        out = np.empty((self._moving.n_state, self._moving.n_bodies))

        def callback_block(ts: Any, t: float, state: Any, rate: Any) -> None:
            counter.evaluations += 1
            try:
                y = self._componentwise(state.getArray(readonly=1))
                if self._bodywise:
                    function(t, y, out)
                    rate.setArray(out.T.ravel())
                else:  # in place: a copy would cost as much as a stage's vector operation
                    function(t, y, rate.getArray().reshape(out.shape))
            except BaseException as failure:
                counter.failure = failure
                raise

        return callback_block

    def _matrix(self) -> Any:
        """Matrix of one dense block per body; a dense matrix for one body."""
        n, size = self._moving.n_bodies, self._moving.n_state
        if n == 1:
            dense = PETSc.Mat().createDense((size, size), comm=PETSc.COMM_SELF)
            dense.setUp()
            dense.assemble()
            return dense
        rows = np.arange(0, n * size * size + 1, size, dtype=PETSc.IntType)
        columns = np.repeat(np.arange(n * size, dtype=PETSc.IntType).reshape(n, size), size, axis=0)
        self._pattern = rows, columns.ravel()
        return PETSc.Mat().createAIJ(
            (n * size, n * size),
            bsize=size,
            csr=(*self._pattern, np.zeros(columns.size)),
            comm=PETSc.COMM_SELF,
        )

    def _set_implicit(self, ts: Any, rate: Callable[..., None], vector: Any) -> None:
        """The equations as dy/dt - f(t, y) = 0 with the Jacobian shift I - df/dy."""
        work = vector.duplicate()
        jacobian = self._jacobian_callback()
        matrix = self._matrix()

        def residual(ts: Any, t: float, state: Any, slope: Any, out: Any) -> None:
            rate(ts, t, state, work)
            out.waxpy(-1.0, work, slope)

        def shifted(
            ts: Any, t: float, state: Any, slope: Any, shift: float, _: Any, matrix: Any
        ) -> None:
            jacobian(t, state, matrix)
            matrix.scale(-1.0)
            matrix.shift(shift)

        ts.setIFunction(residual, vector.duplicate())
        ts.setIJacobian(shifted, matrix, matrix)
        # With the exact Jacobian the error left by a Newton step is its square times a curvature of
        # order one. Residuals are no measure: their rounding grows with the stiffness.
        enough = 0.1 * math.sqrt(self.local_tolerance)

        def converged(_: Any, iteration: int, norms: tuple[float, float, float]) -> int:
            solution, correction, residual = norms
            if not math.isfinite(residual):
                return int(PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_DOMAIN)
            if iteration > 0 and correction <= enough * max(1.0, solution):
                return int(PETSc.SNES.ConvergedReason.CONVERGED_SNORM_RELATIVE)
            return int(PETSc.SNES.ConvergedReason.CONVERGED_ITERATING)

        ts.getSNES().setConvergenceTest(converged)

    def _jacobian_callback(self) -> Callable[[float, Any, Any], None]:
        counter, equations = self.counter, self._moving
        function = equations.jacobian_function(self._expected)
        size = equations.n_state
        blocks = np.empty((equations.n_bodies, size, size))
        indices = np.arange(size, dtype=PETSc.IntType)

        def callback(t: float, state: Any, matrix: Any) -> None:
            counter.jacobians += 1
            try:
                try:
                    function(t, self._componentwise(state.getArray(readonly=1)), blocks)
                except FlowError as refusal:
                    counter.refusal, counter.astray = refusal, True
                except ArithmeticError:
                    counter.refusal, counter.astray = None, True
                if equations.n_bodies == 1 and not np.isfinite(blocks).all():
                    counter.astray = True
                if counter.astray:
                    blocks[:] = 0.0  # whatever comes of it is taken back
                if equations.n_bodies == 1:
                    matrix.setValues(indices, indices, blocks[0])
                else:
                    matrix.setValuesCSR(*self._pattern, blocks)
                matrix.assemble()
            except BaseException as failure:
                counter.failure = failure
                raise

        return callback

    def _componentwise(self, values: Array) -> Array:
        """The vector's values as (n_state, n_bodies) of what is integrated."""
        equations = self._moving
        if self._bodywise:
            return values.reshape(equations.n_bodies, equations.n_state).T
        return values.reshape(equations.n_state, equations.n_bodies)

    def _write(self, vector: Any, states: Array) -> None:
        part = self._moving.integrated(states)
        vector.setArray(part.ravel() if self._bodywise else part.T.ravel())

    def _read(self, vector: Any) -> Array:
        return self._states(vector.getArray(readonly=1))

    def _states(self, values: Array) -> Array:
        """States (n_bodies, n_state) of a vector's values, as a copy."""
        return self._moving.completed(self._componentwise(values).T)

    def _first_step(self) -> float:
        """A step over which nothing moves by more than a tenth of its scale."""
        equations, checkpoint = self.equations, self.checkpoint
        state = np.ascontiguousarray(checkpoint.state.T)
        rate = np.empty_like(state)
        equations.rates(checkpoint.time, state, rate)
        size = self._scales.T + np.abs(state)
        fastest = float(np.max(np.abs(rate) / size))
        if not self._bodywise:
            fastest = max(fastest, float(np.max(equations.stiffness)))
        span = self._end - checkpoint.time
        span = min(span, self._longest or span)
        return min(span, 0.1 / fastest) if fastest > 0.0 else span

    # -- the run ----------------------------------------------------------------------------

    def go(
        self,
        deliver: Callable[[Chunk], None],
        limits: tuple[int, int, float],
        interrupted: Callable[[], bool] | None,
        observe: Callable[[Step], float | None] | None,
    ) -> bool:
        """Step to the end; False if `interrupted` stopped it at the last cut."""
        chunk_samples, chunk_steps, chunk_time = limits
        ts, times = self.ts, self.times
        index, t = self.checkpoint.next_sample, self.checkpoint.time
        samples: list[Array] = []
        while index < len(times) and times[index] <= t:
            samples.append(self._read(self._vector))
            index += 1
        cut = self.checkpoint.steps + chunk_steps
        while index < len(times):
            if interrupted is not None and interrupted():
                return False
            before, start = t, self._vector.getArray(readonly=1).copy()
            halt = None
            try:
                self._step(start)
                t = self._end if _reached(ts.getTime(), self._end) else ts.getTime()
                if observe is not None:
                    halt = observe(self._observed(before, start, t))
            except (FlowError, ConvergenceError) as error:
                if observe is None:
                    raise
                self._end_by(error)
                t, halt = before, before
                self._vector.setArray(start)
            reach = t if halt is None else halt
            behind = int(np.searchsorted(times, reach, "right"))
            many = behind - index > FEW
            while index < behind:
                samples.append(self._state_at(before, start, t, times[index], many))
                index += 1
            if halt is not None:
                # The run becomes one that was to end here.
                self.stopped, last = True, self._state_at(before, start, t, halt)
                if not (index and times[index - 1] == halt):
                    samples.append(last.copy())
                    self.times = np.append(times[:index], halt)
                    index += 1
                self.times = times = self.times[:index]
                self._write(self._vector, last)
                t = halt
            late = ts.getStepNumber() >= cut or t >= self.checkpoint.time + chunk_time
            # BDF starts anew at low order after a cut, which some hundred steps must repay.
            young = self.method == "bdf" and (
                ts.getStepNumber() < self.checkpoint.steps + BDF_STEPS
                and len(samples) < BDF_SAMPLES
            )
            due = (len(samples) >= chunk_samples or late) and not young
            if due or index == len(times):
                self._cut(deliver, t, index, samples)
                ts, samples, times = self.ts, [], self.times
                cut = self.checkpoint.steps + chunk_steps
        if samples:
            self._cut(deliver, t, index, samples)
        return True

    @property
    def _evaluations(self) -> int:
        """Right-hand sides so far, by Python and by PETSc itself."""
        return self.counter.evaluations + (self._native.calls if self._native else 0)

    def _observed(self, before: float, start: Array, after: float) -> Step:
        """The last step, for an observer."""
        first, last = self._states(start), self._read(self._vector)

        asked = 0

        def state(t: float) -> Array:
            nonlocal asked
            asked += before < t < after
            return first if t <= before else self._state_at(before, start, after, t, asked > 1)

        return Step(before, after, first, last, state)

    def _step(self, start: Array) -> None:
        """One accepted step from the vector `start`; else a ConvergenceError or the flow's own.

        A step with a stage where the rate has no value, or that ends where it has none, is taken
        back and tried a quarter as long: the error estimate does not see the stages that both
        formulas weigh alike.
        """
        ts, counter = self.ts, self.counter
        while True:
            near, counter.astray, counter.refusal = counter.astray, False, None
            before, length, number = ts.getTime(), ts.getTimeStep(), ts.getStepNumber()
            self._try_step()
            if near and not counter.astray:  # the end is where the next step starts
                self._rate(ts, ts.getTime(), self._vector, self._inner)
            if not counter.astray:
                counter.astray = near
                self._largest = max(self._largest, ts.getTime() - before)
                break
            self._vector.setArray(start)
            ts.setTime(before)
            ts.setStepNumber(number)
            if length < SHORTEST * self._largest or length < 1e-14 * self._end:
                raise self._failed("", NO_VALUE)
            ts.setTimeStep(0.25 * length)
            ts.restartStep()
        if self._monitored:
            ts.monitor(ts.getStepNumber(), ts.getTime(), self._vector)

    def _try_step(self) -> None:
        """One step of TS; what went astray is for the caller to take back."""
        ts, before = self.ts, self.ts.getTime()
        try:
            ts.step()
        except PETSc.Error as error:
            failure = self.counter.failure
            if failure is not None:
                raise failure from error
            raise self._failed(ADVICE, str(error).strip().splitlines()[-1]) from error
        if self.counter.astray:
            return
        reason = ts.getConvergedReason()
        if reason < 0:
            if before + ts.getTimeStep() == before:
                raise self._failed("", NO_BOUND)
            raise self._failed(ADVICE, REASONS.get(reason, f"reason {reason}"))
        if not math.isfinite(self._vector.norm(PETSc.NormType.NORM_1)):
            # PETSc accepts such a step.
            raise self._failed(ADVICE, "the state is no longer finite")
        if ts.getTime() == before:
            raise self._failed("", NO_BOUND)
        if ts.getStepNumber() >= self._most_steps:
            raise self._failed(ADVICE, "the largest number of steps (-ts_max_steps) is taken")

    def _failed(self, advice: str, what: str) -> ConvergenceError | FlowError:
        """The error for a step that cannot be completed, with time and place."""
        ts, refusal = self.ts, self.counter.refusal
        if isinstance(refusal, FlowFunctionError):
            what, advice = str(refusal), ""
        elif refusal is not None:
            return refusal
        place = ""
        if self.equations.n_bodies == 1:
            centre = self._read(self._vector)[0, :3]
            place = f"body at ({', '.join(f'{value:.6g}' for value in centre)}), "
        return ConvergenceError(
            f"time integration ({self.method}) stopped at t = {ts.getTime():.6g}, {place}step "
            f"{ts.getStepNumber()} with step size {ts.getTimeStep():.3g}: {what}{advice}"
        )

    def _state_at(
        self, before: float, start: Array, after: float, t: float, many: bool = False
    ) -> Array:
        """State at t in [before, after], where `start` is the vector at `before`.

        many: whether so many states of this step are wanted that its polynomial is worth while.
        """
        if t == after:
            return self._read(self._vector)
        if self.method in INTERPOLANT_SUFFICES:
            self.ts.interpolate(t, self._inner)
        elif many and self._native is None:
            if self._inside is None or self._inside[0] != before:
                self._inside = before, self._nodes(before, start, after)
            weights = _hermite((t - before) / (after - before), after - before)
            self._inner.setArray(weights @ self._inside[1])
        else:
            self._substep(before, start, after, t)
        return self._read(self._inner)

    def _nodes(self, before: float, start: Array, after: float) -> Array:
        """States at the ends and the thirds of a step, then the rates there, (8, n)."""
        states, rates = [], []
        slope = self._inner.duplicate()
        for node in THIRDS:
            t = before + node * (after - before)
            if node in (0.0, 1.0):
                self._inner.setArray(start if node == 0.0 else self._vector.getArray(readonly=1))
            else:
                self._substep(before, start, after, t)
            self._rate(self.ts, t, self._inner, slope)
            states.append(self._inner.getArray(readonly=1).copy())
            rates.append(slope.getArray(readonly=1).copy())
        return np.array(states + rates)

    def _substep(self, before: float, start: Array, after: float, t: float) -> None:
        """The formula of the step, only as far as t, to the inner vector."""
        if self._sampler is None:
            self._sampler = self._integrator(self._inner, adaptive=False)
        sampler = self._sampler
        self._inner.setArray(start)
        sampler.setTime(before)
        sampler.setTimeStep(t - before)
        sampler.setMaxTime(2.0 * after - before)
        sampler.restartStep()
        sampler.step()

    def _cut(
        self, deliver: Callable[[Chunk], None], t: float, index: int, samples: list[Array]
    ) -> None:
        """Hand over the samples with a checkpoint, and start afresh from it."""
        ts = self.ts
        state = self._read(self._vector)
        drift = float(np.max(np.abs(np.linalg.norm(state[:, 3:7], axis=1) - 1.0)))
        old = self.checkpoint
        self.checkpoint = Checkpoint(
            time=t,
            state=_of_unit_length(state),
            step=float(ts.getTimeStep()),
            next_sample=index,
            method=self.method,
            local_tolerance=self.local_tolerance,
            reachable=self.reachable,
            steps=ts.getStepNumber(),
            rejections=old.rejections + ts.getStepRejections(),
            evaluations=self._evaluations,
            jacobians=self.counter.jacobians,
            norm_drift=max(old.norm_drift, drift),
        )
        first = index - len(samples)
        states = np.array(samples).reshape(len(samples), *state.shape)
        deliver(Chunk(first, self.times[first:index], _of_unit_length(states), self.checkpoint))
        if index == len(self.times):
            return
        try:
            self._build()
        except (FlowError, ConvergenceError) as error:
            self._end_by(error)
            self.stopped, self.times = True, self.times[:index]

    def _end_by(self, error: FlowError | ConvergenceError) -> None:
        """Note what lets the run go no further."""
        if isinstance(error, FlowError) and not isinstance(error, FlowFunctionError):
            self.refusal = str(error)
        else:
            self.failure = str(error)


THIRDS = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
_APART = THIRDS[:, None] - THIRDS + np.eye(4)
_SLOPES = np.sum(1.0 / _APART, axis=1) - 1.0  # of each Lagrange polynomial at its own node


def _hermite(place: float, step: float) -> Array:
    """Weights (8,) of states and rates at the thirds of a step for a place within it, 0 to 1.

    Hermite's formula: (1 - 2 (x - x_i) l_i'(x_i)) l_i(x)^2 and (x - x_i) l_i(x)^2 with Lagrange's
    polynomials l_i (Abramowitz and Stegun 1964, eq. 25.2.5 for l_i).
    """
    away = place - THIRDS
    factors = np.where(np.eye(4, dtype=bool), 1.0, away[None, :]) / _APART
    squares = np.prod(factors, axis=1) ** 2
    return np.concatenate([(1.0 - 2.0 * away * _SLOPES) * squares, step * away * squares])


def _of_unit_length(states: Array) -> Array:
    """The states (..., n_state), with their quaternions set to length 1."""
    states[..., 3:7] = rotation.normalize(states[..., 3:7])
    return states


def _reached(t: float, end: float) -> bool:
    return t >= end or math.isclose(t, end, rel_tol=1e-14)
