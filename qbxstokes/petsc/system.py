"""The equations of motion as PETSc's TS takes them: vectors, matrices, callbacks, options.

Explicit formulas take flat vectors by component (`motion.layout`), as the kernels sweep them, and
where they are compiled a C function of them (`native`). Implicit ones take them by lane, and a
matrix with one dense block for every lane, which is inverted by itself.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from petsc4py import PETSc

from qbxstokes.errors import ContactError, ConvergenceError, FlowError, FlowFunctionError
from qbxstokes.motion.centred import CentredEquations
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.forecast import EXPLICIT_TYPES, STAGES, Forecast, floor_of
from qbxstokes.motion.layout import ORIENTATION, POSITION, RATES, SPIN, VELOCITY
from qbxstokes.petsc import implicit
from qbxstokes.petsc.session import temporary_options
from qbxstokes.petsc.trajectory import Checkpoint
from qbxstokes.typing import Array

RK_FORMULAS = ("5dp", "8vr")
# Right-hand sides of single bodies in this process so far, as they were forecast.
_FORESEEN = [0.0]
# Integrators with a right-hand side in C that have served: to make one takes as long as 20 steps.
_IDLE: dict[Any, Any] = {}
_NO_LIMIT = 1e20  # PETSc's own longest step


@dataclass
class Counter:
    """What the callbacks of a run note: calls, and what went wrong in the last step."""

    evaluations: int = 0
    jacobians: int = 0
    failure: BaseException | None = field(default=None)
    # what the flow, or a contact, said of the last stage that the rate had no value for
    refusal: FlowError | ContactError | None = None
    astray: bool = False  # a stage of the present step was where the rate has no value


class System:
    """Makes integrators of the equations and moves states in and out of their vectors.

    start: where the run begins; samples: how many states are wanted of it up to `end`; the other
    arguments are those of `stepper.integrate`.
    """

    def __init__(
        self,
        equations: RigidBodyEquations,
        start: Checkpoint,
        end: float,
        samples: int,
        tolerance: float,
        method: str | None = None,
        prefix: str = "",
        longest_step: float | None = None,
        breaks: int = 0,
    ) -> None:
        self.equations, self.end, self._breaks = equations, end, breaks
        self.prefix, self._longest = prefix, longest_step
        self.counter = Counter(start.evaluations, start.jacobians)
        self._changing = equations.changing
        equations.sample(tolerance, start.time, end, longest_step)
        self.guide = Forecast(equations, start.time, start.state, end, tolerance, breaks)
        self._tolerance = tolerance
        self._wanted = start.method or method or self.guide.method
        # Whether it is the program that chose the method.
        self.chosen = method is None and not PETSc.Options().hasName(f"{prefix}ts_type")
        explicit = self._wanted in RK_FORMULAS
        foreseen = self.guide.evaluations("rk" if explicit else self._wanted)
        self.expected = start.expected or foreseen + STAGES * samples
        # By how many right-hand sides compiled ones repay their import. Many short runs of single
        # bodies count together: explicit formulas give the same numbers by either, to the last bit.
        self._repaid = self.expected
        if self.chosen and explicit and equations.layout.columns == 1:
            _FORESEEN[0] += self.expected
            self._repaid = max(self.expected, _FORESEEN[0])
        # What is integrated: the rotation alone where no centre can move. Compiled blocks take 1.2
        # to 2 times less; plain ones gain nothing, implicit ones of one body are in C as a whole.
        self.moving: RigidBodyEquations | CentredEquations = equations
        native = equations.compiled(self._repaid if self.chosen and explicit else 0.0)
        native &= explicit or equations.n_lanes > 1
        if native and equations.at_rest(start.state):
            self.moving = CentredEquations(equations, start.state)
        self.layout = self.moving.layout
        self.native: Any = None
        self._former, self._integrators = list[Any](), list[tuple[Any, Any]]()

    def before_step(self) -> None:
        """Let the compiled right-hand side know what may have changed."""
        if self.native is not None:
            self.native.prepare()

    def after_step(self) -> None:
        """Note what the compiled right-hand side came upon."""
        if self.native is not None and self.native.astray:
            self.counter.refusal, self.counter.astray = None, True

    @property
    def evaluations(self) -> int:
        """Right-hand sides so far, by Python and by PETSc itself."""
        return self.counter.evaluations + (self.native.calls if self.native else 0)

    @property
    def jacobians(self) -> int:
        """The same of Jacobians."""
        return self.counter.jacobians + (self.native.jacobians if self.native else 0)

    @property
    def record(self) -> dict[str, Any]:
        """What a checkpoint keeps of it."""
        kept = "method", "local_tolerance", "reachable", "expected", "evaluations", "jacobians"
        return {name: getattr(self, name) for name in kept}

    @property
    def explicit_in_c(self) -> bool:
        """Whether the right-hand side of an explicit formula is compiled."""
        return self.native is not None and not self._by_lane

    @property
    def leaps(self) -> bool:
        """Whether steps may be taken in C whose stages nobody has to look at."""
        return self.explicit_in_c and self.layout.columns == 1 and self.native.everywhere

    @property
    def place_of_q(self) -> int:
        """Where in the state that is integrated the orientation begins."""
        return ORIENTATION.start if self.moving is self.equations else 0

    def seen(self, t: float) -> tuple[Array, float]:
        """What steps from t are to see, and how far they may go (`flows.signals.Sampled.seen`)."""
        return (np.empty(0), math.inf) if self._changing is None else self._changing.seen(t)

    def cover(self, before: float, after: float) -> float:
        """Know the flow from `before` to `after`, if possible; the instant up to which it is."""
        if self._changing is None:
            return after
        after = min(after, self.end)
        known = self._changing.cover(before, after)
        if self.native is not None:
            self.native.renew()
        return after if known >= after else known

    @property
    def changes(self) -> bool:
        """Whether the flow is known piece by piece."""
        return self._changing is not None

    def near(self, t: float) -> tuple[float, float]:
        """How far a step from t may go to see the flow, and where the flow jumps next."""
        return (math.inf, math.inf) if self._changing is None else self._changing.near(t)

    @property
    def refusal(self) -> FlowError | None:
        """Why the flow is known no further."""
        return None if self._changing is None else self._changing.refusal

    def begin(self, start: Checkpoint) -> Any:
        """The vector of the integrators that start from a checkpoint, and what they measure by."""
        self._start = start
        if not start.local_tolerance and start.steps:  # a change of method, to be thought of anew
            self._wanted = start.method
            self.guide = Forecast(
                self.equations, start.time, start.state, self.end, self._tolerance, self._breaks
            )
        self._scales = self.equations.scales(start.time, start.state)
        if self._changing is not None:  # at the start the flow may be as good as still
            rates = self._scales[:, VELOCITY.start :]
            np.maximum(rates, 1.0 / (self.end or 1.0), out=rates)
        return PETSc.Vec().createSeq(self.layout.size, comm=PETSc.COMM_SELF)

    def _made(self, adaptive: bool) -> Any:
        """A TS of the wanted type, by defaults below the options."""
        ts = PETSc.TS().create(PETSc.COMM_SELF)
        ts.setOptionsPrefix(self.prefix)
        if self._wanted in RK_FORMULAS:
            ts.setType("rk")
            ts.setRKType(self._wanted)
        else:
            ts.setType(self._wanted)
        ts.setMaxSteps(2**31 - 1)
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.MATCHSTEP)
        ts.setErrorIfStepFails(False)
        ts.setMaxStepRejections(100)
        ts.setMaxSNESFailures(-1)  # a step whose equations are not solved is shortened
        # The Newton solver inside has the prefix ts_, apart from the solver of integral equations.
        ts.getSNES().setOptionsPrefix(f"{self.prefix}ts_")
        defaults = {
            "ts_adapt_wnormtype": "infinity",
            "ts_arkimex_type": "5",
            "ts_bdf_order": "6",
            "ts_snes_linesearch_type": "basic",
            "ts_ksp_type": "preonly",
            "ts_pc_type": "lu" if self.layout.lanes == 1 else "pbjacobi",
        }
        forced = {} if adaptive else {"ts_adapt_type": "none"}
        with temporary_options(self.prefix, defaults, forced):
            ts.setFromOptions()
        return ts

    def integrator(self, vector: Any, adaptive: bool) -> Any:
        """A TS of the wanted type with its callbacks, a new one or one that is idle."""
        options = PETSc.Options().getAll()
        key = self._wanted, vector.size, adaptive, self.prefix
        told = any(name.startswith(f"{self.prefix}ts_") for name in options)
        ts = (None if told else _IDLE.pop(key, None)) or self._made(adaptive)
        ts.restartStep()
        ts.setMaxTime(self.end)
        if f"{self.prefix}ts_adapt_dt_max" not in options:
            ts.setStepLimits(ts.getStepLimits()[0], self._longest or _NO_LIMIT)
        kind = str(ts.getType())
        self._by_lane = kind not in EXPLICIT_TYPES
        if self.native is not None and hasattr(self.native, "solve_with") != self._by_lane:
            # Functions for formulas of the other kind: what they have counted stays, and so do
            # they, for integrators that live.
            self.counter.evaluations += self.native.calls
            self.counter.jacobians += self.native.jacobians
            self._former.append(self.native)
            self.native = None
        self.method = str(ts.getRKType()) if kind == "rk" else kind
        self.local_tolerance = self._start.local_tolerance or self.guide.tolerance(kind)
        self.reachable = self._start.reachable or self.guide.reachable(kind)
        weights = vector.duplicate()
        self.write(weights, self._weights(kind))
        if self._by_lane:
            implicit.give(self, ts, vector, weights)
        elif (native := self._native_rate()) is not None:
            native.give(ts, vector.duplicate())
        else:
            ts.setRHSFunction(self.rate, vector.duplicate())
        ts.setTolerances(rtol=self.local_tolerance, atol=weights)
        ts.setSolution(vector)
        self._integrators.append((None if told or not self.leaps else key, ts))
        return ts

    def release(self, idle: bool) -> None:
        """Free the integrators; idle: but those that may serve other runs of a single body."""
        for key, ts in self._integrators:
            if idle and key is not None and key not in _IDLE:
                _IDLE[key] = ts
            else:
                ts.destroy()
        self._integrators = []

    def _weights(self, kind: str) -> Array:
        """Errors of a step that are accepted of small components, (columns, n_state).

        A velocity may be off by what drag lets it move the body, up to the tolerance itself.
        One component of a vector is known to rounding of the largest, since the equations turn it
        into the body's frame and back: what is less than that is asked of none.
        """
        accepted, state = self.local_tolerance * self._scales, self._start.state
        if not self.equations.massless:
            across, along, turn, spin = self.equations.relaxation_rates
            lasting = np.stack([*3 * [np.minimum(across, along)], turn, turn, spin], axis=1)
            least, most = accepted[:, RATES], self._tolerance * self._scales[:, RATES]
            accepted[:, RATES] = np.clip(self.local_tolerance * lasting, least, most)
        for part in (POSITION,) if self.equations.massless else (POSITION, VELOCITY, SPIN):
            size = np.linalg.norm(state[:, part], axis=1, keepdims=True)
            accepted[:, part] = np.maximum(accepted[:, part], 4.0 * floor_of(kind) * size)
        return np.asarray(accepted)

    def _native_rate(self) -> Any:
        """The compiled rate as a C function, one for all integrators of the run, or None."""
        wall = self.equations.over_wall
        if self.native is None and wall is not None:
            from qbxstokes.petsc.native_wall import NativeOverWall

            self.native = NativeOverWall.made(*wall, self.counter)
        elif self.native is None and (found := self.equations.function_rows) is not None:
            if found[0].grid_of_run is not None:
                from qbxstokes.petsc.native_user import NativeUser

                self.native = NativeUser.made(*found, self.layout)
        elif self.native is None:
            block = self.moving.block_constants(self._repaid)
            if block is not None:
                from qbxstokes.petsc.native import NativeRate

                self.native = NativeRate.made(block, self.layout)
        return self.native

    def native_implicit(self) -> Any:
        """The equations of a single body as C functions for implicit formulas, or None."""
        if self.native is None and self.layout.columns == 1:
            block = self.moving.block_constants(self._repaid)
            if block is not None:
                from qbxstokes.petsc.native_implicit import NativeImplicit

                self.native = NativeImplicit.made(block, self.layout)
        return self.native

    @cached_property
    def rate(self) -> Callable[[Any, float, Any, Any], None]:
        """The right-hand side as a function of Python that TS may call."""
        counter, equations = self.counter, self.equations

        alone, direct = equations.layout.columns == 1, equations.direct
        if alone and not (direct or equations.compiled(self._repaid)):
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
                except (FlowError, ContactError) as refusal:
                    counter.refusal, counter.astray = refusal, True
                    rate.set(0.0)
                except BaseException as failure:
                    counter.failure = failure
                    raise

            return callback

        function = self.moving.rate_function(self._repaid)
        out = np.empty((self.layout.n_state, self.layout.columns))

        def callback_block(ts: Any, t: float, state: Any, rate: Any) -> None:
            counter.evaluations += 1
            try:
                y = self.componentwise(state.getArray(readonly=1))
                if self._by_lane:
                    function(t, y, out)
                    rate.setArray(self.layout.flat_by_lane(out.T))
                else:  # in place: a copy would cost as much as a stage's vector operation
                    function(t, y, rate.getArray().reshape(out.shape))
                if alone and direct and not math.isfinite(rate.getArray().sum()):
                    counter.refusal, counter.astray = None, True
                    rate.set(0.0)
            except BaseException as failure:
                if (self.layout.bodies > 1 or alone) and isinstance(
                    failure, (FlowError, ContactError)
                ):
                    counter.refusal, counter.astray = failure, True
                    rate.set(0.0)  # whatever comes of it is taken back
                    return
                counter.failure = failure
                raise

        return callback_block

    def failed(self, ts: Any, vector: Any, advice: str, what: str) -> Exception:
        """The error for a step that cannot be completed, with time and place."""
        refusal, place = self.counter.refusal, ""
        if isinstance(refusal, FlowFunctionError):
            what, advice = str(refusal), ""
        elif refusal is not None:
            return refusal
        if self.layout.columns == 1:
            centre = self.read(vector)[0, POSITION]
            place = f"body at ({', '.join(f'{value:.6g}' for value in centre)}), "
        return ConvergenceError(
            f"time integration ({self.method}) stopped at t = {ts.getTime():.6g}, {place}"
            f"step {ts.getStepNumber()} with step size {ts.getTimeStep():.3g}: {what}{advice}"
        )

    def componentwise(self, values: Array) -> Array:
        """The vector's values as (n_state, columns) of what is integrated."""
        return self.layout.by_lane(values) if self._by_lane else self.layout.by_component(values)

    def write(self, vector: Any, states: Array) -> None:
        """Put whole states (columns, n_state) into a vector."""
        part = self.moving.integrated(states)
        vector.setArray(self.layout.flat_by_lane(part) if self._by_lane else part.T.ravel())

    def read(self, vector: Any) -> Array:
        """Whole states (columns, n_state) of a vector, as a copy."""
        return self.states(vector.getArray(readonly=1))

    def states(self, values: Array) -> Array:
        """Whole states (..., columns, n_state) of a vector's values (..., size), as a copy."""
        return self.moving.completed(self.layout.states(values, self._by_lane))

    def first_step(self) -> float:
        """A step over which nothing moves by more than a tenth of its scale."""
        equations, checkpoint = self.equations, self._start
        state = np.ascontiguousarray(checkpoint.state.T)
        rate = np.empty_like(state)
        equations.rates(checkpoint.time, state, rate)
        size = self._scales.T + np.abs(state)
        fastest = float(np.max(np.abs(rate) / size))
        if not self._by_lane:
            fastest = max(fastest, float(np.max(equations.stiffness)))
        span = min(self.end - checkpoint.time, self._longest or math.inf)
        return min(span, 0.1 / fastest) if fastest > 0.0 else span
