"""Integration of the equations of motion by PETSc TS.

`TS.step` takes one step at a time: sampling, events and checkpoints sit between the steps (`leaps`:
between those that matter), which do not depend on the instants that are asked for.

Events are roots of functions of the states inside a step (`dense_output`). TSSetEventHandler would
end steps there, so that the motion depends on what is watched for, within TSSolve alone, which
leaves no place for cuts, and its instants err by 1e-7 to 1e-6 in a motion good to 1e-8.

Tolerance. It is the error at the end of the run that the user accepts, in q and, relative to
max(1, |x|), in x. Both Runge-Kutta pairs propagate the formula of higher order and control the
lower one, which makes the global error proportional to the local tolerance; the factor is the
sensitivity of the equations (`RigidBodyEquations.sensitivity`), and the tolerance is divided by it.

The quaternion's length has no effect on the motion (`motion.taylor`); it is 1 after every cut.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from petsc4py import PETSc

from qbxstokes.errors import ContactError, ConvergenceError, FlowError, FlowFunctionError, Stopping
from qbxstokes.flows.signals import NO_BOUND
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.layout import ORIENTATION, Step
from qbxstokes.petsc.dense_output import Inside
from qbxstokes.petsc.implicit_pace import Pace
from qbxstokes.petsc.leaps import Leaps
from qbxstokes.petsc.session import require_honest
from qbxstokes.petsc.system import System
from qbxstokes.petsc.trajectory import Checkpoint, Chunk, Trajectory, Watch, of_unit_length

Array = NDArray[np.float64]

# Fewest steps of BDF between two cuts, unless so many samples wait.
BDF_STEPS, BDF_SAMPLES = 1000, 20_000
# Share of the longest step below which a step with a stage that has no value is given up.
SHORTEST = 1e-4
REASONS = {-1: "the nonlinear solve failed", -2: "too many steps were rejected"}
NO_VALUE = "the rates of change have no finite value further on, however short the step"
ADVICE = (
    ". Try a larger tolerance, another -ts_type (implicit ones: arkimex, rosw, bdf) or "
    "-ts_adapt_monitor to see why steps are rejected"
)


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
    breaks: ArrayLike = (),
    watch: Watch | None = None,
) -> Trajectory:
    """States at increasing `times` of the motion that starts from `start` at t0.

    start: states (columns, n_state) as in `motion.layout`, or the checkpoint of an interrupted run
    with the same other arguments, which then ends with the same numbers. tolerance: error accepted
    at the end. method: "5dp", "8vr", "rosw", "arkimex" or "bdf"; None chooses, options `-ts_*` with
    `prefix` override it.
    on_chunk receives the samples in pieces of about `chunk_samples` (and at least every
    `chunk_steps` steps or `chunk_time` a piece, possibly without samples) and they are not kept;
    a piece of a BDF run is longer where it would have fewer than `BDF_STEPS` steps.
    observe is called after every step and may return an instant of it at which the run ends; with
    it, a step that cannot be completed ends the run (`refusal`, `failure`) instead of failing it.
    longest_step: bound on the steps, for loads that the start tells nothing about.
    breaks: instants at which the equations are not smooth in time: steps end there, and begin
    afresh. watch: what looks after the flow (`Watch`).
    Raises ConvergenceError, or what the flow raised, when a step cannot be completed.
    """
    shape = equations.layout.columns, equations.layout.n_state
    require_honest()
    instants = np.asarray(times, dtype=np.float64)
    if not isinstance(start, Checkpoint):
        start = Checkpoint(t0, np.array(start, dtype=np.float64).reshape(shape))
    end, count = float(instants[-1]), len(instants)
    ends = np.asarray(breaks, dtype=np.float64)
    bound = longest_step, len(ends)
    system = System(equations, start, end, count, tolerance, method, prefix, *bound)
    run = Run(system, start, instants, ends, watch or Watch())
    kept: list[Chunk] = []
    limits = chunk_samples, chunk_steps, chunk_time
    try:
        finished = run.go(on_chunk or kept.append, limits, interrupted, observe)
    except Stopping:  # within a step, or while its samples were made
        finished = False
    finally:
        run.release()
    told = "checkpoint", "stopped", "refusal", "failure", "reached"
    return Trajectory(
        times=np.concatenate([np.empty(0), *(chunk.times for chunk in kept)]),
        states=np.concatenate([np.empty((0, *shape)), *(chunk.states for chunk in kept)]),
        finished=finished,
        longest_step=longest_step,
        flow_samples=0 if equations.changing is None else equations.changing.asked,
        **{name: getattr(run, name) for name in told},
    )


class Run:
    """One integration in progress."""

    def __init__(
        self, system: System, checkpoint: Checkpoint, times: Array, breaks: Array, watch: Watch
    ) -> None:
        self._breaks, self._watch, self._system = breaks, watch, system
        self.equations, self.checkpoint, self.times = system.equations, checkpoint, times
        self.stopped, self.refusal, self.failure = False, "", ""
        self._jumps = False  # whether the flow is kept as before a jump
        self.reached = checkpoint.time
        self._largest, self._end = 0.0, system.end
        self.counter = system.counter
        monitor = f"{system.prefix}ts_monitor"
        self._monitored = any(name.startswith(monitor) for name in PETSc.Options().getAll())
        self.ts: Any = None
        self._inside: Any = None
        self._build()

    def _build(self) -> None:
        """Fresh integrators at the checkpoint: a resumed run passes through the same code."""
        # Whether a step begins at a break, and how long such a step may be, as former ones were.
        self._fresh, self._anew = False, math.inf
        start, system = self.checkpoint, self._system
        self.release(idle=True)
        self._watch.begin(start.time, start.state)
        self._vector = system.begin(start)
        self.ts = system.integrator(self._vector, adaptive=True)
        self._inside = Inside(system, self.ts, self._vector)
        self._pace = Pace(system, start, self._vector)
        self._most_steps, self._rejected = self.ts.getMaxSteps(), self.ts.getStepRejections()
        system.write(self._vector, start.state)
        self.ts.setTime(start.time)
        self.ts.setStepNumber(start.steps)
        self.ts.setTimeStep(start.step or system.first_step())

    def release(self, idle: bool = False) -> None:
        """Free the integrators: they hold callbacks that hold this object, unseen by Python."""
        self._watch.rest()
        self._watch.until(math.inf)
        self._system.release(idle)
        self.ts = self._inside = None

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
        watch = None if getattr(observe, "idle", False) else observe
        leaps = self._leaps(watch)
        while index < len(times) and times[index] <= t:
            samples.append(self._system.read(self._vector))
            index += 1
        cut = self.checkpoint.steps + chunk_steps
        while index < len(times):
            if interrupted is not None and interrupted():
                return False
            before, start, halt = t, self._vector.getArray(readonly=1).copy(), None
            seen = watch is not None
            try:
                until = min(times[index], self.checkpoint.time + chunk_time)
                if leaps and not self._jumps and leaps.take(t, until, min(cut, self._most_steps)):
                    before, start, seen = leaps.before, leaps.start, leaps.passed
                    self._judge(before, leaps.error)
                else:
                    self._to_break(t, start)
                t = min(ts.getTime(), self._end)
                t = self._end if math.isclose(t, self._end, rel_tol=1e-14) else t
                if watch is not None and seen:
                    halt = watch(self._inside.observed(before, start, t))
            except (FlowError, ContactError, ConvergenceError) as error:
                if observe is None:
                    raise
                self._end_by(error)
                t, halt = before, before
                self._vector.setArray(start)
            self.reached = t
            reach = t if halt is None else halt
            behind = index if reach < times[index] else int(times.searchsorted(reach, "right"))
            if index < behind:
                samples += self._inside.states_at(before, start, t, times[index:behind])
                index = behind
            if halt is not None:
                # The run becomes one that was to end here.
                self.stopped, last = True, self._inside.state_at(before, start, t, halt)
                if not (index and times[index - 1] == halt):
                    samples.append(last.copy())
                    self.times = np.append(times[:index], halt)
                    index += 1
                self.times = times = self.times[:index]
                self._system.write(self._vector, last)
                t = halt
            late = ts.getStepNumber() >= cut or t >= self.checkpoint.time + chunk_time
            # BDF starts anew at low order after a cut, which some hundred steps must repay.
            least = min(BDF_STEPS, 20 * chunk_steps) if self._system.method == "bdf" else 0
            taken = ts.getStepNumber() - self.checkpoint.steps
            young = taken < least and len(samples) < BDF_SAMPLES
            due = (len(samples) >= chunk_samples or late) and not young
            held_up = self._pace.held_up(t, ts.getStepNumber(), ts.getStepRejections())
            if due or held_up or index == len(times):
                self._cut(deliver, t, index, samples, held_up)
                ts, samples, times = self.ts, [], self.times
                leaps = None if index == len(times) else self._leaps(watch)
                cut = self.checkpoint.steps + chunk_steps
        if samples:
            self._cut(deliver, t, index, samples)
        self.release(idle=not self.stopped)
        return True

    def _leaps(self, watch: Any) -> Leaps | None:
        """What takes steps that nobody looks at; None where each one is looked at."""
        looked_at = self._monitored or self._watch.looks or self._pace.looks
        given = self._system, self.ts, self._vector, watch
        return None if looked_at or len(self._breaks) else Leaps.of(*given)

    def _to_break(self, t: float, start: Array) -> None:
        """One accepted step from t, up to the next break at most."""
        ts, breaks, system = self.ts, self._breaks, self._system
        if not (len(breaks) or system.changes):
            self._step(start)
            return
        length, place = ts.getTimeStep(), int(breaks.searchsorted(t, "right"))
        last = place == len(breaks)
        limit = self._end if last else float(breaks[place])
        since = t if place and breaks[place - 1] == t else -math.inf
        if len(breaks) or self._jumps:
            self._watch.until(limit, since)
        known = system.cover(t, min(t + length, limit))
        near, jump = system.near(t)
        self._jumps = jump < limit
        if self._jumps:
            limit, last = jump, False
            self._watch.until(limit, since)
            known = system.cover(t, min(t + length, limit))
        # Steps of BDF that go up and down are not stable, and their errors not seen.
        if near < t + length and system.method != "bdf":
            ts.setTimeStep(near - t)
        if not last and t + ts.getTimeStep() > limit - 1e-3 * length:
            ts.setTimeStep(limit - t)
        if known < min(t + length, limit):
            self.counter.refusal = system.refusal
            if known - t <= 1e-13 * self._end:
                raise self._failed("", NO_VALUE)
            ts.setTimeStep(known - t)
        asked = ts.getTimeStep()
        self._step(start)
        if self._fresh:
            taken, self._fresh = ts.getTime() - t, False
            self._anew = taken if taken < 0.99 * asked else 2.0 * self._anew
        if not last and (ts.getTime() >= limit or math.isclose(ts.getTime(), limit, rel_tol=1e-13)):
            ts.setTime(limit)
            ts.setTimeStep(min(max(ts.getTimeStep(), length), self._end - limit, self._anew))
            ts.restartStep()
            self._fresh = True

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
                self._system.rate(ts, ts.getTime(), self._vector, self._inside.scratch)
            if not counter.astray and self._accepted():
                counter.astray = near
                self._largest = max(self._largest, ts.getTime() - before)
                break
            self._vector.setArray(start)
            ts.setTime(before)
            ts.setStepNumber(number)
            ts.restartStep()
            if counter.astray and length < max(SHORTEST * self._largest, 1e-14 * self._end):
                raise self._failed("", NO_VALUE)
            ts.setTimeStep(0.25 * length if counter.astray else length)
        if self._monitored:
            ts.monitor(ts.getStepNumber(), ts.getTime(), self._vector)

    def _accepted(self) -> bool:
        """Whether the watch lets a step stand."""
        if not self._watch.looks:
            return True
        try:
            return self._watch.accept(self.ts.getTime(), self._system.read(self._vector))
        except FlowError as refusal:
            if isinstance(refusal, FlowFunctionError):
                raise
            self.counter.refusal, self.counter.astray = refusal, True
            return False

    def _try_step(self) -> None:
        """One step of TS; what went astray is for the caller to take back."""
        before, failed = self.ts.getTime(), None
        self._system.before_step()
        try:
            self.ts.step()
        except PETSc.Error as error:
            failed = error
        else:
            self._system.after_step()
        if failed or not self.counter.astray:
            self._judge(before, failed)

    def _judge(self, before: float, error: Any) -> None:
        """Raise what is wrong with the step from `before`, or with its callbacks."""
        ts = self.ts
        if error is not None:
            what = str(error).strip().splitlines()[-1]
            raise self.counter.failure or self._failed(ADVICE, what) from error
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

    def _failed(self, advice: str, what: str) -> Exception:
        return self._system.failed(self.ts, self._vector, advice, what)

    def _cut(
        self,
        deliver: Callable[[Chunk], None],
        t: float,
        index: int,
        samples: list[Array],
        held_up: bool = False,
    ) -> None:
        """Hand over the samples with a checkpoint, and start afresh from it."""
        ts = self.ts
        state = self._system.read(self._vector)
        drift = float(np.max(np.abs(np.linalg.norm(state[:, ORIENTATION], axis=1) - 1.0)))
        old = self.checkpoint
        new = Checkpoint(
            time=t,
            state=of_unit_length(state),
            step=float(ts.getTimeStep()),
            next_sample=index,
            steps=ts.getStepNumber(),
            rejections=old.rejections + ts.getStepRejections() - self._rejected,
            norm_drift=max(old.norm_drift, drift),
            changed=old.changed,
            **self._system.record,
        )
        if held_up:
            new = self._pace.changed(new)
        self._watch.rest()
        first = index - len(samples)
        states = np.array(samples).reshape(len(samples), *state.shape)
        deliver(Chunk(first, self.times[first:index], of_unit_length(states), new))
        self.checkpoint = new
        if index == len(self.times):
            return
        try:
            self._build()
        except (FlowError, ContactError, ConvergenceError) as error:
            self._end_by(error)
            self.stopped, self.times = True, self.times[:index]

    def _end_by(self, error: FlowError | ContactError | ConvergenceError) -> None:
        """Note what lets the run go no further."""
        failed = isinstance(error, (ConvergenceError, FlowFunctionError))
        self.failure, self.refusal = (str(error), self.refusal) if failed else ("", str(error))
