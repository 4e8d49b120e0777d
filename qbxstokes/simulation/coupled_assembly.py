"""The assembly of bodies that share a fluid: equations, what these ask, events and results."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.bie.multiple_scattering import LEAST_NODES, closest, gaps_of, names_of
from qbxstokes.bie.scatterer import scatterer
from qbxstokes.errors import ContactError, FlowError, SceneError, Stopping
from qbxstokes.flows.interpolation import Between
from qbxstokes.geometry import rotation
from qbxstokes.geometry.symmetric import components, symmetric
from qbxstokes.motion.coupled import CoupledEquations, WallConstants
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.motion.meetings import Meetings, Nearness
from qbxstokes.motion.observables import observe
from qbxstokes.petsc.trajectory import Watch
from qbxstokes.quantities import MOTION, of_event
from qbxstokes.simulation import arguments as given
from qbxstokes.simulation.result import Motion, integration_facts
from qbxstokes.simulation.solved_instant import MOST_NODES, rooms
from qbxstokes.simulation.watching import breaks_of, split_columns, stops_of, watched
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.coupled import CoupledSimulation

# Steps and samples between cuts, where a run can be resumed: some seconds of work.
CUT_STEPS, CUT_SAMPLES = 5, 20
# Share of the tolerance of velocities by which they jump where grids change.
_NOISE = 0.01
# Steps at least over a run whose flow or loads change in time.
_STEPS_IN_TIME = 20.0
# Local tolerance above which 5dp takes fewer right-hand sides than 8vr.
_LOOSE = 1e-6


class Together(Between, Watch):
    """A scene ready to be integrated: equations, and the states (N, n_state) that they start from.

    What `assembly.Assembled` is for lanes of one body. It is the fluid of its equations, too: each
    answer to them is a problem of its own. asked: whether a signal asks the run to stop; raises
    `Stopping` then, before the next problem.
    """

    thermal = None
    asked: Callable[[], bool] | None = None

    def __init__(self, scene: CoupledSimulation) -> None:
        self.scene = scene
        self.iterations = self.solves = 0
        self.errors: dict[str, float] = {}
        self.relative_error = 0.0
        self._terms: Array | None = None
        bodies, stokes = scene.suspension.bodies, scene.stokes_number
        size = np.array([body.size for body in bodies])
        volume = size**3 * np.array([body.shape.volume for body in bodies])
        inertia = size[:, None] ** 5 * np.array([body.shape.inertia for body in bodies])
        relaxation = np.zeros((4, len(bodies)))
        if np.any(stokes):
            drag = [scatterer(body.shape, LEAST_NODES).resistance for body in bodies]
            for b, own in enumerate(drag):
                moved, turned = own[:3] * size[b] / volume[b], own[3:] * size[b] ** 3 / inertia[b]
                relaxation[:, b] = np.array([*moved[[0, 2]], *turned[[0, 2]]]) / stokes[b]
        ratios = np.array([float(body.shape.effective_ratio) for body in bodies])
        given = volume, inertia, relaxation, self.constants, _NOISE * scene.suspension.tolerance
        self.equations = CoupledEquations(self, ratios, stokes, *given)
        self.initial = self.equations.initial_state(
            scene.position, scene.quaternion, scene.velocity, scene.angular_velocity
        )

    # -- what is done with it -----------------------------------------------------------------

    def trajectory(self, times: Array, start: Any = None, **settings: Any) -> Any:
        """`petsc.stepper.integrate` of the equations with the scene's tolerance."""
        from qbxstokes.petsc import session

        session.start()
        from qbxstokes.petsc.stepper import integrate

        equations, end, flow = self.equations, float(times[-1]), self.scene.flow
        local = self.scene.tolerance / equations.sensitivity(0.0, self.initial, end)
        longest, breaks = None, np.empty(0)
        if not (self.scene.steady and (flow is None or flow.steady)):
            longest = min(end / _STEPS_IN_TIME, math.inf if flow is None else flow.spacing)
        if flow is not None and longest:
            stops = stops_of([flow], end, 0.01 * self.scene.tolerance, longest)
            breaks = np.union1d(breaks_of([flow], end, local / longest), stops)
        limits = {"chunk_samples": CUT_SAMPLES, "chunk_steps": CUT_STEPS}
        return integrate(
            equations,
            self.initial if start is None else start,
            times,
            self.scene.tolerance,
            method=("5dp" if local > _LOOSE else "8vr") if equations.massless else None,
            longest_step=longest,
            breaks=breaks,
            watch=self,
            **{**limits, **settings},
        )

    def watch(self) -> Meetings:
        """What watches for contacts and turning points; raises SceneError where one is there."""
        scene, section = self.scene, self.scene.events
        arm = np.array([body.size * body.shape.radius for body in scene.suspension.bodies])
        wall, edges = scene.suspension.wall, scene.flow is not None and bool(scene.flow.domain)
        normal = None if wall is None else wall.normal
        turning = section.turning_points
        watch = Meetings(self.equations, self.nearness, arm, normal, edges, turning)
        near = self.nearness(self.initial)
        if near.room <= 0.0:
            if section.clearance is None:
                raise SceneError("start", f"is too near: {near.reason}", "a wider gap")
            raise SceneError("events.clearance", f"is {section.clearance:g}", near.reason)
        return watch

    def nearness(self, states: Array) -> Nearness:
        """How near the bodies may still come to each other, to the wall and to the flow's edges."""
        scene = self.scene
        suspension = scene.suspension
        places = suspension.placed(states[:, POSITION], states[:, ORIENTATION])
        gap, (b, c), _ = closest(places, suspension.wall)
        least = gap, (b + 1, c + 1)
        bound = scene.events.clearance
        reason = f"{names_of(b, c)}: the gap fell to {bound or 0.0:.3g}"
        near = Nearness(gap - (bound or 0.0), *least, "clearance", reason, least[1])
        found = gaps_of(places, suspension.wall)
        free, tolerance = self.equations.massless, suspension.tolerance
        room = rooms(found, places, suspension.wall, tolerance, free)
        if len(room) and (bound is None or room.min() < near.room):
            at = int(np.argmin(room))
            b, c = found.pairs[at].tolist()
            name = "wall_contact" if c < 0 else "body_contact"
            reason = (
                f"{names_of(b, c)}: at the gap {found.gap[at]:.3g} the tolerance {tolerance:.0e} "
                f"would take more than {MOST_NODES} polar nodes"
            )
            near = Nearness(float(room[at]), *least, name, reason, (b + 1, c + 1))
        for edge in scene.flow.domain if scene.flow is not None else ():
            reach = np.stack([p.size**2 * p.shape.extent(p.axis) for p in places])
            away = edge.gap(states[:, POSITION], reach)
            body = int(np.argmin(away))
            if away[body] < near.room:
                reason = f"body {body + 1} reached {edge}, where its flow ends"
                near = Nearness(float(away[body]), *least, "domain_exit", reason, (body + 1, 0))
        return near

    def observe(self, times: Array, states: Array, wanted: Sequence[str]) -> dict[str, Array]:
        """The wanted quantities (T, N, ...) from states (T, N, n_state) at times (T,)."""
        shear = None if self.scene.flow is None else self.scene.frame.shear
        about = shear, self, self.scene.tolerance
        found = observe(self.equations, times, states, False, wanted, *about)
        return {name: found[name] for name in dict.fromkeys((*wanted, *found))}

    def gaps(self, states: Array) -> Array:
        """The least gap (T,) of each of the states (T, N, n_state)."""
        return np.array([self.nearness(state).gap for state in states])

    def integrate(self, times: ArrayLike) -> CoupledMotion:
        """The motion sampled at times (T,)."""
        instants = given.instants(times)
        trajectory, watch = watched(self, instants)
        self.estimate_along(trajectory, watch)
        return CoupledMotion.together(self, trajectory, watch)

    def estimate_along(self, trajectory: Any, watch: Meetings) -> None:
        """Estimate the error of the velocities at the start, at the end and at the least gap."""
        self.estimate(0.0, self.initial)
        end = trajectory.checkpoint
        self.estimate(end.time, end.state)
        if watch.nearest is not None and watch.nearest_state is not None:
            t = watch.nearest[2]
            if 0.0 < t < end.time:
                self.estimate(t, watch.nearest_state)

    def expected_errors(self, end: float, rounding: float) -> dict[str, float]:
        """Largest error of centres and axes to expect at the end, and what it consists of.

        integration: the tolerance; grids: the estimated error of the velocities all the way;
        rounding: of all steps. Bodies that meet, or fall as a cloud, may end further off.
        """
        grids = max(self.errors.values()) * end
        parts = {"integration": self.scene.tolerance, "grids": grids, "rounding": rounding}
        return {"total": sum(parts.values()), **parts}

    # -- what its equations ask ---------------------------------------------------------------

    def free(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """Velocities of the bodies under their loads."""
        told = self._from_table(t, x, q)
        if told is not None:
            return told
        found = self._solved("free", t, x, q)
        return found.velocity, found.angular_velocity

    def drag(self, t: float, x: Array, q: Array, v: Array, omega: Array) -> tuple[Array, Array]:
        """Force and torque of the fluid ON the bodies."""
        told = self._from_table(t, x, q, np.hstack([v, omega]))
        if told is not None:
            return told
        found = self._solved("held", t, x, q, velocity=v, angular_velocity=omega)
        return -found.force, -found.torque

    def resistance(self, t: float, x: Array, q: Array) -> Array:
        """Resistance (6N, 6N) of the bodies to the accuracy that a Jacobian needs."""
        table = self.scene.table
        if table is not None:
            with suppress(ContactError, SceneError):
                place = x[0], rotation.axis(q)[0]
                return np.linalg.inv(table.free_and_mobility(table.flow_terms(None), *place)[1])
        return np.asarray(self._solved("resistance", t, x, q))

    def _from_table(
        self, t: float, x: Array, q: Array, motion: Array | None = None
    ) -> tuple[Array, Array] | None:
        """Free velocities, or with a motion force and torque, from the table; None beyond it."""
        scene, table = self.scene, self.scene.table
        degree = 0 if scene.flow is None else scene.flow.degree
        if table is None or degree is None or degree > 2:
            return None
        if self._terms is None or (scene.flow is not None and not scene.flow.steady):
            self._terms = table.flow_terms(scene.flow, t)
        try:
            if motion is None:
                load = np.hstack(self.loads(t, x, q))
                return table.motion(self._terms, x, rotation.axis(q), load)
            drag = table.drag(self._terms, x[0], rotation.axis(q)[0], motion[0])
        except (ContactError, SceneError):
            return None
        return drag[None, :3], drag[None, 3:]

    @property
    def constants(self) -> Callable[[], WallConstants] | None:
        """What the compiled rate over a wall takes, where all of it is the table's."""
        scene, table = self.scene, self.scene.table
        flow, loads = scene.flow, scene.loads
        if table is None or scene.repulsion is not None or not (scene.massless and scene.steady):
            return None
        if flow is not None and not (flow.steady and flow.degree is not None and flow.degree <= 2):
            return None
        own: tuple[Any, ...] = () if loads is None else (loads.body_force, loads.body_torque)
        if any(np.any(vectors) for vectors in own):
            return None
        terms = table.flow_terms(flow, 0.0)
        load = np.hstack(self.loads(0.0, scene.position, scene.quaternion))[0]
        return lambda: table.constants(terms, load)

    def loads(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """Force and torque from outside."""
        still = np.zeros((len(q), 3))
        found = self.scene.forces(t, x, q)
        return found.get("force", still), found.get("torque", still)

    def gradient(self, t: float, x: Array) -> Array:
        """Velocity gradient of the flow at the centres."""
        flow = self.scene.flow
        return np.zeros((len(x), 3, 3)) if flow is None else np.asarray(flow.gradient(x, t))

    def stresslet(self, t: float, x: Array, q: Array, p: Array, torque: Any) -> Array:
        """Stresslets (N, 6) of the free bodies."""
        return components(self._solved("free", t, x, q).stresslet)

    def estimate(self, t: float, y: Array) -> None:
        """Take the estimated errors of the velocities in a state into account."""
        x, q = y[:, POSITION], rotation.normalize(y[:, ORIENTATION])
        found = self._solved("estimate", t, x, q)
        for name in ("velocity", "angular_velocity"):
            share = found.relative_errors.get(name, 0.0)
            if self.scene.table is not None:
                share += self.scene.table.error_estimate
            self.relative_error = max(self.relative_error, share)
            error = share * found.sizes[name]
            self.errors[name] = max(self.errors.get(name, 0.0), error)

    def _solved(self, kind: str, t: float, x: Array, q: Array, **motion: Array) -> Any:
        scene = self.scene
        if self.asked is not None and self.asked():
            raise Stopping
        try:
            places = scene.suspension.placed(x, q)
            nodes = scene.suspension.grids(places, scene.flow, t, True, kind != "held")
        except SceneError as error:  # beyond the edge of the flow, or at its singular point
            raise FlowError(str(error)) from None
        # From nothing, not from the last solution: numbers do not depend on what was asked before.
        found = scene.solved(kind, t, x, q, nodes, **motion)
        if kind != "resistance":
            self.solves += 1
            self.iterations += found.iterations
        return found


@dataclass(frozen=True)
class CoupledMotion(Motion):
    """A motion of bodies that share a fluid: arrays (T, N, ...), or (T, ...) of a single body.

    gap (T,): the least of the scene. ended_by: None, `wall_contact`, `body_contact`, `clearance` or
    `domain_exit`, with what it says in message; the last sample is then that instant.
    """

    gap: Array

    @classmethod
    def together(cls, assembled: Together, trajectory: Any, watch: Meetings) -> CoupledMotion:
        """From the states of an integration."""
        times, states = trajectory.times, trajectory.states
        several = assembled.scene.several
        found = assembled.observe(times, states, tuple(MOTION))
        values = {name: found[name] if several else found[name][:, 0] for name in MOTION}
        events = {
            name: split_columns(rows, of_event(name, coupled=True))
            for name, rows in watch.take().items()
        }
        summary = {
            **integration_facts(trajectory),
            **facts(assembled, trajectory),
            "events": meetings_summary(watch),
        }
        return cls(
            times,
            **values,
            summary=summary,
            events=events,
            _assembled=assembled,  # type: ignore[arg-type]
            _states=states,
            gap=assembled.gaps(states),
        )

    @property
    def ended_by(self) -> str | None:
        """The event that ended the motion before its last instant."""
        found: str | None = self.summary["events"].get("ended_by")
        return found

    @property
    def message(self) -> str:
        """What that event says."""
        return str(self.summary["events"].get("ended_because", ""))

    @cached_property
    def stresslet(self) -> Array:
        """Stresslets (T, N, 3, 3), space frame; computed when asked."""
        return symmetric(self.stresslet6)

    @cached_property
    def stresslet6(self) -> Array:
        """Their components 11, 22, 33, 12, 13, 23, as files hold them."""
        assembled: Any = self._assembled
        found = assembled.observe(self.time, self._states, ("stresslet",))["stresslet"]
        return found if assembled.scene.several else found[:, 0]

    def between(self, begin: float, end: float) -> CoupledMotion:
        """The samples from begin to end, both included."""
        first, last = np.searchsorted(self.time, begin), np.searchsorted(self.time, end, "right")
        part = slice(first, last)
        values = {name: getattr(self, name)[part] for name in (*MOTION, "time", "gap")}
        return replace(self, **values, _states=self._states[part])

    def averages(self, discard: float = 0.0) -> dict[str, Array]:
        """Not there: half-turns are those of a body alone."""
        raise SceneError("averages", "are those of one body alone", "averages of the samples")

    def comparison(self) -> Any:
        """No reference is known."""
        from qbxstokes.simulation.compare import Comparison

        return Comparison()


def facts(assembled: Together, trajectory: Any) -> dict[str, Any]:
    """What the solves of a motion took, the estimated errors of its velocities, and at its end."""
    at = trajectory.checkpoint
    found = {
        "solves": assembled.solves,
        "iterations": assembled.iterations,
        "velocity_errors": dict(assembled.errors),
    }
    if assembled.errors:
        found["relative_error"] = assembled.relative_error
        found["expected_error"] = assembled.expected_errors(at.time, at.reachable)
    return found


def meetings_summary(watch: Meetings) -> dict[str, Any]:
    """What was seen, in a few numbers."""
    summary: dict[str, Any] = {"counts": dict(watch.counts)}
    if watch.nearest is not None and math.isfinite(watch.nearest[0]):
        gap, (b, c), t = watch.nearest
        summary["nearest"] = {"gap": gap, "who": names_of(b - 1, c - 1), "time": t}
    if watch.ended[0]:
        summary |= {"ended_by": watch.ended[0], "ended_because": watch.ended[1]}
    return summary
