"""Equations of motion of a block of rigid bodies of revolution: lanes that are integrated together.

State of a body: (x, q), 7 numbers, for St = 0; (x, q, V, W), 13 numbers, for St > 0 (`layout`).
Arrays of states are (n_lanes, n_state) for the user and (n_state, n_lanes) in `rates` and
`jacobian`, which is how the kernels sweep them. A lane has one body here; bodies that feel each
other need equations of their own, with a `layout` of several bodies in a lane and Jacobians of
whole lanes, which the integrator takes as they are.

The hydrodynamics enter through the free motion (U, Omega), the one without force and torque. Drag
is linear, F = R_t (U - V), so that loads only shift the motion that the drag pulls to:

    St = 0:  dx/dt = U + R_t^-1 F_ext,  dq/dt = (0, Omega + R_r^-1 M_ext) * q / 2
    St > 0:  dx/dt = V,  dq/dt = q * (0, W) / 2,  St Theta dV/dt = R_t (U + R_t^-1 F_ext - V),
             St J dW/dt = R_r (Omega + R_r^-1 M_ext - W) - St W x (J W)      (body frame)

(Bagge 2015, eqs. 3.26-3.29.) For k > 0 with this symmetry translation and rotation do not couple
through drag, so that each may be prescribed while the other stays free. Likewise the inertia of
either may be switched off for St > 0: that part then moves as for St = 0, and its V or W stays
zero, unread.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from typing import Any

import numpy as np

from qbxstokes.errors import FlowError
from qbxstokes.geometry import rotation
from qbxstokes.motion import taylor
from qbxstokes.motion.diagnostics import growth
from qbxstokes.motion.layout import N_MASSLESS, ORIENTATION, POSITION, VELOCITY
from qbxstokes.motion.loads import Constraints, Loads
from qbxstokes.motion.loops import BlockConstants
from qbxstokes.motion.pieces import Inertia, Pieces
from qbxstokes.motion.tracing import specialise
from qbxstokes.typing import Array

__all__ = ["Constraints", "Inertia", "Loads", "RigidBodyEquations"]


# From this size of the block, or this number of right-hand sides of single bodies in a process or
# of fewer lanes than that, the compiled kernels repay their import (0.4 s, and some seconds of
# compilation once on a machine, against some 6 us a right-hand side of one body and 80 us of
# several). They find the same numbers, to the last bit.
COMPILED_BLOCK = 8
COMPILED_EVALUATIONS = 60_000
COMPILED_EVALUATIONS_OF_FEW = 1_000
# Squares of max(k, 1/k) from which, steps below which and lanes up to which the growth of errors is
# followed; relaxations in a strain time of bodies that follow the flow.
_SLENDER, _MOST, _FEW, _LIGHT = 50.0, 600, 16, 20.0
_ANYWHERE = np.array(
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [1, 1, -1], [1, -1, 1], [-1, 1, 1]]
)


class RigidBodyEquations(Pieces):
    """dy/dt and its Jacobian for `n_lanes` lanes; see the module's text for the equations.

    model: the body model that all lanes share, or a sequence with one for each, of one class of
    laws. flow: a polynomial flow (degree <= 3), whose free motion follows from the model's Faxen
    coefficients, or any provider with `free_motion`; a provider with `force_torque` is asked for
    the force itself when St > 0; or a sequence with one for each lane, all polynomial or none.
    stokes_number: a number or (n_lanes,), all zero or all positive. inertia: of translation and
    rotation "both", or of one of them alone (St > 0); the other follows the flow.
    """

    # Right-hand sides that take as long as a step of BDF, and whether its Jacobian is exact. In
    # Python as in C: forecasts of which takes less time are within a factor of two.
    bdf_cost, exact_jacobian = 50.0, True
    # Error of a step below which differences of implicit formulas see the errors of the rates.
    noise = 0.0
    # The fastest rate of relaxation in states at a time, where it changes on the way.
    stiffness_at: Callable[[float, Array], float] | None = None
    _sensitivity: tuple[tuple[float, bytes, float], float] | None = None

    def repeated(self, count: int) -> RigidBodyEquations:
        """The equations of `count` times the same lanes: many instants as many lanes.

        Only where no loads or constraints depend on time (`steady`). Times may be those of lanes.
        """
        loads = self._given_loads
        found = RigidBodyEquations(
            self.bodies.models.repeated(count),
            self._flows.repeated(count),
            np.tile(self.stokes_number, count),
            self.n_lanes * count,
            None if loads is None else loads.repeated(count),
            self.constraints.repeated(count),
            self.evaluation,
            self.inertia,
        )
        if found.changing is not None and self.changing is not None:
            found.changing.follow(self.changing)
        return found

    def compiled(self, evaluations: float = 0.0) -> bool:
        """Whether the compiled kernels serve, given how many right-hand sides are to come."""
        possible = self._table is not None and self.constraints.free
        if self.evaluation != "auto":
            return possible and self.evaluation == "compiled"
        if self.n_lanes == 1:
            return possible and evaluations >= COMPILED_EVALUATIONS
        few = evaluations >= COMPILED_EVALUATIONS_OF_FEW
        return possible and (self.n_lanes >= COMPILED_BLOCK or few)

    def rate_function(
        self, evaluations: float = 0.0, still: Array | None = None
    ) -> Callable[[float, Array, Array], None]:
        """The function (t, y, out) that writes dy/dt for y (n_state, n_lanes), read-only.

        still: centres that stay, where y is to be without them (`motion.centred`, compiled alone).
        """
        if (motion := self._of_run) is not None:
            return motion[0].rates_of_run(motion[1])  # type: ignore[no-any-return]
        if self.direct:
            found: Callable[[float, Array, Array], None] = self._provider.rates  # type: ignore[union-attr]
            return found
        return self._compiled("rate_block", (still,)) if self.compiled(evaluations) else self.rates

    @property
    def direct(self) -> bool:
        """Whether the provider finds dy/dt itself."""
        own = self.free_of_torque and hasattr(self._provider, "rates")
        return own or self._of_run is not None

    @property
    def _of_run(self) -> tuple[Any, Array] | None:
        """`function_rows` in a run."""
        found = self.function_rows
        return None if found is None or found[0].grid_of_run is None else found

    def jacobian_function(self, evaluations: float = 0.0) -> Callable[[float, Array, Array], None]:
        """The function (t, y, out) that writes the blocks (n_lanes, n_state, n_state)."""
        if (motion := self._of_run) is not None:
            return motion[0].slopes_of_run(motion[1])  # type: ignore[no-any-return]
        return self._compiled("jacobian_block") if self.compiled(evaluations) else self.jacobian

    @property
    def over_wall(self) -> tuple[Any, Any] | None:
        """What is compiled of one body over a wall (`motion.coupled`): nothing."""
        return None

    @property
    def function_rows(self) -> tuple[Any, Array] | None:
        """The motion in a compiled flow and rows (21, n) of the bodies, where these are all.

        Relaxation rates and mobilities (4 each; zero where there are no loads), gyration, and the
        loads (12) as in `driven_motion`.
        """
        free = self.constraints.free and self._follow is None and self._steady_loads
        if not free or not hasattr(self._provider, "grid_of_run"):
            return None
        rows = np.zeros((21, self.n_lanes))
        if not self.massless:
            rows[:4], rows[8] = self.relaxation_rates, self.bodies.gyration
        if self._loads is not None:
            rows[4:8], rows[9:] = 1.0 / self.bodies.resistance, self._loads.rows
        return self._provider, rows

    def block_constants(self, evaluations: float = 0.0) -> BlockConstants | None:
        """All that the compiled loop takes, where it serves and nothing of it depends on time."""
        return self._block() if self._steady_loads and self.compiled(evaluations) else None

    def at_rest(self, y: Array) -> bool:
        """Whether all centres stay where they are in the states y (n_lanes, n_state), for good.

        The free velocity of a body vanishes at the centre of a flow that is odd about it, however
        the body lies, since the body is its own image there. What is left are forces and a velocity
        at the start.
        """
        if self._table is None or not self.constraints.free:
            return False
        pushed = self._loads is not None and self._loads.push
        moving = not self.massless and np.any(y[:, VELOCITY])
        return not (pushed or moving) and all(
            np.all(flow.odd_about(y[lanes, POSITION])) for flow, lanes in self._flows.groups()
        )

    def sample(self, tolerance: float, begin: float, end: float, longest: float | None) -> None:
        """From now on know flows that change as polynomials in time, from `begin` to `end`."""
        if self.changing is None:
            return
        span, accuracy = end or 1.0, self.accuracy_in_time(tolerance)
        longest = longest or 0.02 * span
        if self.changing.sample(span, accuracy, longest):  # what was found of others is void
            self._mean_rate, self._sensitivity = (None, np.empty(0)), None
        if end > 0.0:
            self.changing.cover(begin, min(end, begin + longest))

    def sensitivity(self, t: float, y: Array, horizon: float) -> float:
        """How many times the error of one step may grow until `horizon` later.

        An axis that a shear turns lingers in one direction and hurries through the rest: a lag
        grows by max(k, 1/k)^2 from the one to the other, and one more is made at every turn. The
        error of both Runge-Kutta pairs after ten periods is 0.04 to 1.4 times the tolerance then,
        for k from 1/50 to 50. In gradients that change there is no such direction: there it is what
        slender bodies' own motion makes of it (`growth`).
        """
        asked = t, y.tobytes(), horizon
        if self._sensitivity is not None and self._sensitivity[0] == asked:
            return self._sensitivity[1]
        slenderness = np.maximum(self.effective_ratio, 1.0 / self.effective_ratio)
        span = self.mean_rate(t, y, horizon) * horizon
        grown = slenderness * slenderness
        if np.max(grown) > _SLENDER and self._axes_alone(y):
            with suppress(FlowError):  # told when the run comes to it
                grown = np.minimum(grown, self._growth(t, y, horizon, float(np.max(span))))
        found = float(np.max(grown * np.maximum(1.0, span / (2.0 * np.pi * slenderness))))
        self._sensitivity = asked, found
        return found

    def _growth(self, t: float, y: Array, horizon: float, span: float) -> Any:
        """How many times errors of axes alone may grow; inf where that takes too many steps."""
        seen = horizon / min(flow.spacing for flow in self._flows.distinct)
        if not max(seen, 4.0 * span) < _MOST:
            return math.inf
        steps = math.ceil(max(60.0, seen, 4.0 * span))
        gradients = self._gradients(y, t + horizon * (np.arange(steps) + 0.5) / steps)
        (rest, linear), *_ = self.bodies.law
        axes, law = rotation.axis(rotation.normalize(y[:, ORIENTATION])), [linear, rest]
        if self.massless or np.all(self.relaxation_rates[2:] > _LIGHT * self.time_rate(t, y)):
            return growth(gradients, law, axes, horizon / steps)
        # Where it lags behind the flow the axis may come anywhere.
        count, n = 1 + len(_ANYWHERE), self.n_lanes
        axes = np.concatenate([axes, np.repeat(_ANYWHERE, n, axis=0)])
        law = [np.tile(np.broadcast_to(number, n), count) for number in law]
        found = growth(np.tile(gradients, (1, count, 1, 1)), law, axes, horizon / steps)
        return found.reshape(count, n).max(axis=0)

    def _axes_alone(self, y: Array) -> bool:
        """Whether few axes alone turn in linear flows that change."""
        few = self.changing is not None and self._degree <= 1 and self.n_lanes <= _FEW
        return few and self._loads is None and self._follow is None and self.at_rest(y)

    def integrated(self, states: Array) -> Array:
        """The part of states (n_lanes, n_state) that is integrated: all."""
        return states

    def completed(self, part: Array) -> Array:
        """The states of what is integrated, as a copy."""
        return np.array(part)

    def _block(self) -> BlockConstants:
        assert self._table is not None
        flow, body, degree, kernels = (
            self._table,
            self.bodies.table,
            self._degree,
            self.bodies.kernels,
        )
        return BlockConstants(
            kernels,
            degree,
            flow if flow.ndim == 1 else flow[: taylor.ROWS[degree]],
            body if body.ndim == 1 else body[: kernels.ROWS[degree]],
            None if self._loads is None else self._loads.rows,
            None if self.massless else self.relaxation_rates,
            self._follow,
            changing=self.changing,
        )

    def _compiled(
        self, loop: str, more: tuple[Array | None, ...] = ()
    ) -> Callable[[float, Array, Array], None]:
        """A compiled loop over the block with its constant arguments, the last of them `more`."""
        from qbxstokes.motion.compiled import compiled_loops

        block = self._block()
        run = compiled_loops(block.kernels, block.degree, self.massless).by_name[loop]
        flow, body, rates, follow = block.flow, block.body, block.rates, block.follow

        def function(t: float, y: Array, out: Array) -> None:
            loads = None if self._loads is None else self._loads.at(t)
            if self.changing is not None:
                flow[self.changing.rows] = self.changing.at(t)
            run(y, out, flow, body, loads, rates, follow, *more)

        return function

    def rates(self, t: float, y: Array, out: Array) -> None:
        """Write dy/dt, (n_state, n_lanes), by the plain kernels."""
        for row, value in zip(out, self.rate_of_rows(t, self._rows(y)), strict=True):
            row[:] = value

    @property
    def rate_of_rows(self) -> Callable[[float, Any], Any]:
        """dy/dt as a tuple, (t, rows) -> n_state rows, plain or complex.

        rows: the numbers of a single body, or rows (n_lanes,). Looked up once for many calls; kept
        in no attribute, where a bound method would hold the provider's solvers in a cycle.
        """
        return self._pieces if self._kernel is None else self._kernel

    def jacobian(self, t: float, y: Array, out: Array) -> None:
        """Write the Jacobian, (n_lanes, n_state, n_state), by the plain kernels.

        Exact to rounding by complex steps for polynomial flows; for a provider its free motion is
        differenced (central, relative error about 1e-10) and the rest is exact.
        """
        rows = list(self._rows(y))
        step = taylor.STEP * 1.0j
        motion = self._motion(t, rows)
        provided = self._table is None
        columns = []
        for j in range(self.n_state):
            moved = [*rows[:j], rows[j] + step, *rows[j + 1 :]]
            if provided or j >= N_MASSLESS:  # the free motion does not depend on velocities
                columns.append(self._rate(t, moved, motion))
            else:
                columns.append(self.rate_of_rows(t, moved))
        out[:] = self._slopes(columns)
        if provided:
            columns = []
            for j in range(6):
                local = (*motion[:j], motion[j] + step, *motion[j + 1 :])
                columns.append(self._rate(t, rows, local))
            out[:, :, :N_MASSLESS] += self._slopes(columns) @ self._motion_slopes(t, y)

    @cached_property
    def _kernel(self) -> Callable[..., Any] | None:
        """dy/dt by the kernels in one piece: for polynomial flows without constraints.

        Where all lanes share flow and body it is specialised to them, and only numbers that differ
        from lane to lane, or in time, are handed over with the states.
        """
        if self._table is None or not self.constraints.free:
            return None
        given, several = self._loads, self.n_lanes > 1
        handed = given is not None and (several or not given.steady)
        loads = None if given is None or handed else self._rows(given.rows)
        rates = self._rows(self.relaxation_rates)
        n_rates = 4 if several and not self.massless else 0

        bodies = self.bodies

        n_changing = 0 if self.changing is None else len(self.changing.rows)
        after_loads = 12 * handed

        def equations(rows: Any, more: Any) -> Any:
            pushes = tuple(more[:12]) if handed else loads
            flow = self._flow_of(more[after_loads + n_rates :]) if n_changing else self._flow
            arguments = rows, flow, bodies.law, bodies.mobility, pushes
            if self.massless:
                return bodies.kernels.massless(*arguments)
            relaxation = more[after_loads : after_loads + 4] if n_rates else rates
            return bodies.kernels.inertial(*arguments, relaxation, bodies.gyration, self._follow)

        if self._flows.shared and bodies.models.shared:
            key = None
            if not several:  # the constants, of which scenes that are alike have the same
                unread = self.free_of_torque  # NaN, which equals nothing
                flow = self._flow_of([0.0] * n_changing) if n_changing else self._flow
                places = tuple(self.changing.rows.tolist()) if self.changing is not None else ()
                made = bodies.kernels.__name__, flow, places, bodies.law, bodies.gyration
                more = None if unread else (bodies.mobility, tuple(rates), self._follow)
                key = *made, more, None if loads is None else tuple(loads), handed
            kernel = specialise(equations, self.n_state, after_loads + n_rates + n_changing, key)
            if not (handed or n_rates or n_changing):
                return kernel
        else:

            def kernel(t: float, rows: Any, more: Any) -> Any:
                return equations(rows, more)

        def with_numbers(t: float, rows: Any) -> Any:
            forces = self._rows(given.at(t)) if given is not None and handed else ()
            changing = () if self.changing is None else self.changing.at(t)
            return kernel(t, rows, (*forces, *(rates if n_rates else ()), *changing))

        return with_numbers

    def _pieces(self, t: float, rows: Any) -> Any:
        """dy/dt put together from the kernels, for providers and constraints."""
        return self._rate(t, rows, self._motion(t, rows))

    def _slopes(self, columns: list[Any]) -> Array:
        """(n, n_state, columns) from the values of complex steps, columns first."""
        if self.n_lanes > 1:
            columns = [np.broadcast_arrays(*column) for column in columns]
        values = np.array(columns).imag.reshape(len(columns), self.n_state, self.n_lanes)
        return np.asarray(np.moveaxis(values, -1, 0).swapaxes(1, 2) / taylor.STEP)
