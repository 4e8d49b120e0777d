"""The one assembly: bodies, flows, loads, constraints and the integrator meet here alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import ConvergenceError, SceneError
from qbxstokes.flows import ChangingFlow
from qbxstokes.flows.interpolation import INTERPOLATIONS
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.averages import turn_averages
from qbxstokes.motion.diagnostics import orbit_constant
from qbxstokes.motion.equations import Constraints, Loads, RigidBodyEquations
from qbxstokes.motion.observables import observe
from qbxstokes.motion.stress import StressSource
from qbxstokes.quantities import STRESS
from qbxstokes.simulation import arguments as given
from qbxstokes.simulation.hydrodynamics import Hydrodynamic, hydrodynamics_of
from qbxstokes.simulation.lanes import LaneRun
from qbxstokes.simulation.result import Motion
from qbxstokes.simulation.watching import (
    FlowWatch,
    breaks_of,
    build_events,
    require_stokesian,
    stops_of,
    watched,
)
from qbxstokes.typing import Array, Indices

if TYPE_CHECKING:
    from qbxstokes.bie.functional import BodyModel
    from qbxstokes.simulation.simulation import Simulation


_PERIODIC = "period", "period_change", "orbit_drift"
# What makes the hydrodynamics of a scene: its integral equation, or closed forms in a forecast.
Maker = Callable[["Simulation"], Hydrodynamic]
# Steps at least over a run whose flow or loads change in time, of which the start tells nothing.
_STEPS_IN_TIME = 50.0
# Instants at which such a flow is checked before the run.
_INSTANTS_CHECKED = 11
_EPSILON = 2.0**-52
# Steps of a single lane between cuts, where a run can be resumed: a fraction of a second of work
# or some seconds, by how the free motion is found; and samples at most.
CUT_STEPS = {"table": 5000, "grid": 500, "every_step": 100}
CUT_SAMPLES = 10_000
# About what a step costs a lane (s) by how its free motion is found, and how much work lies between
# two cuts of several lanes. Constants, since where the cuts are the numbers depend on.
STEP_COST = {"table": 7e-7, "plain": 7e-6, "grid": 1.3e-4, "every_step": 1.3e-2}
CUT_WORK = 4.0


@dataclass
class Assembled:
    """A scene, or several stacked, ready to be integrated: equations and their start.

    initial: states (n, n_state) of all lanes. again: assembles other scenes in the same way.
    """

    parts: tuple[Simulation, ...]
    hydrodynamics: tuple[Hydrodynamic, ...]
    equations: RigidBodyEquations
    initial: Array
    again: Callable[[Sequence[Simulation]], Assembled]

    @property
    def tolerance(self) -> float:
        """Error accepted at the end."""
        return self.parts[0].tolerance

    @property
    def steady(self) -> bool:
        """Whether no flow depends on time."""
        return all(part.flow.steady for part in self.parts)

    def slices(self) -> list[slice]:
        """Lanes of each part."""
        ends = np.cumsum([len(part) for part in self.parts])
        return [slice(end - len(part), end) for end, part in zip(ends, self.parts, strict=True)]

    def some(self, lanes: Indices) -> Assembled:
        """Some of the lanes, by their numbers in increasing order."""
        chosen = [
            lanes[(lanes >= own.start) & (lanes < own.stop)] - own.start for own in self.slices()
        ]
        parts = zip(self.parts, chosen, strict=True)
        return self.again([part.at(own) for part, own in parts if len(own)])

    def trajectory(self, times: Array, start: Any = None, **settings: Any) -> Any:
        """`petsc.stepper.integrate` of the equations with the scene's tolerance.

        start: a checkpoint to go on from, or None. settings: chunks, observers and the like.
        """
        from qbxstokes.petsc.stepper import integrate

        end = float(times[-1])
        longest = self._longest_step(end)
        limits = {"chunk_samples": CUT_SAMPLES, "chunk_steps": CUT_STEPS[self.parts[0].kind]}
        if len(self.initial) > 1:  # lanes are kept in memory: a cut would only move their bits
            limits = {
                "chunk_samples": len(times) + 1,
                "chunk_steps": max(20, self.steps_of(CUT_WORK)),
            }
        return integrate(
            self.equations,
            self.initial if start is None else start,
            times,
            self.tolerance,
            longest_step=longest,
            breaks=self._breaks(end, longest),
            watch=FlowWatch(self, end),
            **{**limits, **settings},
        )

    def _breaks(self, end: float, longest: float | None) -> Array:
        """`watching.breaks_of` all flows, and `stops_of` those whose functions are asked."""
        flows, equations = [part.flow for part in self.parts], self.equations
        found = breaks_of(flows, end, 0.0)
        if not longest:  # nothing changes in time, or the run is its start
            return found
        if equations.changing is not None:
            if not len(found):
                return found
            local = self.tolerance / equations.sensitivity(0.0, self.initial, end)
            return breaks_of(flows, end, local / longest)
        stops = stops_of(flows, end, equations.accuracy_in_time(self.tolerance), longest)
        return np.union1d(found, stops)

    def _longest_step(self, end: float) -> float | None:
        """Bound on the steps where something changes in time: the start tells nothing of it.

        Raises SceneError for a flow that is not Stokesian at some instant of the run.
        """
        if self.steady and self.equations.steady:
            return None
        for part in self.parts:
            if not (part.flow.steady or part.flow.surely_stokesian):
                for t in np.linspace(0.0, end, _INSTANTS_CHECKED):
                    require_stokesian(part, part.position[0], float(t))
        spacings = [part.flow.spacing for part in self.parts]
        return float(min(end / _STEPS_IN_TIME, *spacings))

    def steps_of(self, work: float) -> int:
        """Steps of all lanes that are about so many seconds of work, from 1 to 10,000."""
        kind = self.parts[0].kind
        if kind == "table" and not self.equations.compiled():
            kind = "plain"
        return int(np.clip(work / (len(self.initial) * STEP_COST[kind]), 1, 10_000))

    def watch(self) -> Any:
        """What watches for events between the steps of a single lane; raises SceneError."""
        return build_events(self.parts[0], self.equations, self.initial)

    @cached_property
    def stress(self) -> StressSource:
        """The stresslets of the lanes; forms those of the bodies when first asked."""
        from qbxstokes.simulation.stresses import SceneStress

        return SceneStress(self)

    def observe(self, times: Array, states: Array, wanted: Sequence[str]) -> dict[str, Array]:
        """The wanted quantities (T, n, ...) from states (T, n, n_state) at times (T,)."""
        shears = [part.frame.shear for part in self.parts]
        shear = shears[0] if len(shears) == 1 else None
        stress = self.stress if any(name in STRESS for name in wanted) else None
        about = shear, stress, self.tolerance
        found = observe(self.equations, times, states, self.steady, wanted, *about)
        if "orbit_constant" in found and len(self.parts) > 1:
            for lanes, part, shear in zip(self.slices(), self.parts, shears, strict=True):
                axes, k = found["axis"][:, lanes], part.body.effective_ratio
                found["orbit_constant"][:, lanes] = (
                    np.nan if shear is None else orbit_constant(axes, k, shear)
                )
        return found

    def averages(
        self, times: Array, samples: Mapping[str, Array], discard: float = 0.0
    ) -> dict[str, Array]:
        """Averages over whole half-turns (`motion.averages`) of samples (T, n, ...), (n, ...)."""
        found = [
            turn_averages(
                times,
                {name: values[:, lanes] for name, values in samples.items()},
                part.body.effective_ratio,
                part.frame,
                discard,
            )
            for lanes, part in zip(self.slices(), self.parts, strict=True)
        ]
        for part, averages in zip(self.parts, found, strict=True):
            if part.brownian is not None:  # turns that have no period
                averages |= {name: np.full(len(part), np.nan) for name in _PERIODIC}
        return {name: np.concatenate([part[name] for part in found]) for name in found[0]}

    def expected_errors(self, end: float, rounding: float = 0.0) -> list[dict[str, float]]:
        """Error of the axis to expect at the end, of each part, and what it consists of.

        integration: the tolerance; law: what the error of the body's law comes to, which shifts the
        turns of the body in time; rounding: of all steps. In flows that carry bodies with slightly
        different starts apart the motion may end further off.
        """
        found = []
        whole = self.equations
        for part, formed, lanes in zip(self.parts, self.hydrodynamics, self.slices(), strict=True):
            if part.flow.steady and part.flow.degree is not None:
                rate = np.linalg.norm(part.gradient)
            elif part.flow.steady or whole.changing is None:
                instants = np.linspace(0.0, end, 1 if part.flow.steady else _INSTANTS_CHECKED)
                rate = np.mean(np.linalg.norm(_gradients(part, instants), axis=(1, 2)))
            else:
                rate = whole.mean_rate(0.0, self.initial, end)[lanes].mean()
            linear = part.carrier.degree is not None and part.carrier.degree <= 1
            law = float(rate) * end * _period_error(formed.model, linear)
            parts = {"integration": self.tolerance, "law": law, "rounding": rounding}
            found.append({"total": sum(parts.values()), **parts})
        return found

    def sampling(self, end: float) -> dict[str, float]:
        """Error at the end that the samples of a series leave of axis and position of one lane.

        For smooth gradients: that of every other sample is 2^order times as large; where their
        number is even, up to the last but one of them. Empty where the flow is no series, or one of
        too few samples.
        """
        scene, flow = self.parts[0], self.parts[0].flow
        if len(self.initial) != 1 or not isinstance(flow, ChangingFlow):
            return {}
        series = flow.signal.series
        if series is None:
            return {}
        order = INTERPOLATIONS[series.interpolation]
        if len(series.times) < 2 * max(2, order) - 1:
            return {}
        thinned = series.thinned()
        other = copy(scene)
        other.flow = flow.of_series(thinned)
        again = self.again([other])
        last = end if series.outside != "error" else min(end, float(thinned.times[-1]))
        fine, rough = (each.trajectory(np.array([last])) for each in (self, again))
        share = 1.0 / max(1.0, 2.0**order - 1.0)
        found = [
            each.observe(run.times, run.states, ("axis", "position"))
            for each, run in ((self, fine), (again, rough))
        ]
        return {
            name: share * float(np.linalg.norm(found[0][name][-1, 0] - found[1][name][-1, 0]))
            for name in ("axis", "position")
        }

    def integrate(self, times: ArrayLike) -> Motion:
        """The motion sampled at times (T,)."""
        instants = given.instants(times)
        if len(self.initial) > 1 or self.parts[0].brownian is not None:
            run = LaneRun.of(self, instants)
            trajectory = run.go()
            if trajectory.failure or trajectory.refusal:
                raise ConvergenceError(trajectory.failure or trajectory.refusal)
            whole = replace(trajectory, times=instants, states=run.states)
            return Motion.of(self, whole, None, run)
        trajectory, watch = watched(self, instants)
        return Motion.of(self, trajectory, watch)


def assemble(
    parts: Sequence[Simulation],
    *,
    t: float = 0.0,
    evaluation: Any = "auto",
    maker: Maker = hydrodynamics_of,
) -> Assembled:
    """Put the scenes together: the only place where body, flow, loads and equations meet.

    Their flows are to have been checked. evaluation: of the right-hand side
    (`RigidBodyEquations`). maker: what makes the hydrodynamics. Raises SceneError for scenes that
    cannot be integrated together.
    """
    parts = tuple(parts)
    formed = tuple(maker(part) for part in parts)
    first = parts[0]
    counts = [len(part) for part in parts]
    models: Any = formed[0].model
    flows: Any = formed[0].provider
    if len(parts) > 1:
        _check_alike(parts)
        models = [h.model for h, n in zip(formed, counts, strict=True) for _ in range(n)]
        if any(h.provider is not flows for h in formed):
            flows = [h.provider for h, n in zip(formed, counts, strict=True) for _ in range(n)]
    equations = RigidBodyEquations(
        models,
        flows,
        np.concatenate([part.stokes_number for part in parts]),
        sum(counts),
        _joined(Loads, [part.loads for part in parts], counts),
        _joined(Constraints, [part.constraints for part in parts], counts),
        evaluation,
        first.body.inertia,
    )
    initial = equations.initial_state(
        np.concatenate([part.position for part in parts]),
        np.concatenate([part.quaternion for part in parts]),
        _stacked([part.velocity for part in parts]),
        _stacked([part.angular_velocity for part in parts]),
        t,
    )
    again = partial(assemble, t=t, evaluation=evaluation, maker=maker)
    return Assembled(parts, formed, equations, initial, again)


def _gradients(part: Simulation, t: Array) -> Array:
    """About the gradients (T, 3, 3) at the start, at instants (T,)."""
    flow, place = part.carrier, part.position[:1]
    if part.recognised is None and not flow.singular_points_known:  # many values for many digits
        return np.array([flow.expansion(place, s, 1)[1][0] for s in t.tolist()])
    return np.asarray(flow.gradients(place, t)[:, 0])


def _period_error(model: BodyModel, linear: bool) -> float:
    """Relative error of the periods of a body's motion, at most.

    A period needs what a shear along the body leaves of its rotation, 1/2 - |lambda|/2, which is
    small for thin and flat bodies. A spheroid's is known: k^2/(1 + k^2), or 1/(1 + k^2) if less.
    """
    ratio = model.effective_ratio
    slenderness = max(ratio, 1.0 / ratio)
    if linear and isinstance(model.shape, Spheroid):
        square = min(ratio, 1.0 / ratio) ** 2
        rest = square / (1.0 + square)
        off = abs(abs(model.faxen.linear) + 2.0 * rest - 1.0)
        return 0.5 * abs(model.faxen.rest / rest - 1.0) + off + _EPSILON
    return model.error_estimate * slenderness


def _check_alike(parts: Sequence[Simulation]) -> None:
    """Whether the parts may share one integration."""

    def kinds(part: Simulation) -> dict[str, Any]:
        bound = part.constraints or Constraints()
        return {
            "tolerance": part.tolerance,
            "inertia": part.body.inertia,
            "whether there is inertia": part.massless,
            "a velocity at the start": part.velocity is None,
            "an angular_velocity at the start": part.angular_velocity is None,
            "loads": part.loads is None,
            "brownian": part.brownian and (part.brownian.translation, part.brownian.seed),
            "constraints": tuple(value is None for value in vars(bound).values()),
            "flow": part.kind if part.kind == "table" else id(part.flow),
        }

    first = kinds(parts[0])
    for part in parts[1:]:
        for name, value in kinds(part).items():
            if value != first[name]:
                raise SceneError("lanes", f"differ in {name}", "lanes that agree in it")


def _joined(kind: Any, given: Sequence[Any], counts: Sequence[int]) -> Any:
    """Loads or constraints of all lanes; None where no part has any."""
    if len(given) == 1 or all(entry is given[0] for entry in given):
        return given[0]
    fields = []
    for name in vars(given[0]):
        values = [getattr(entry, name) for entry in given]
        if all(value is values[0] for value in values):
            fields.append(values[0])
        elif any(callable(value) for value in values):
            raise SceneError("lanes", f"have functions of time as {name}", "the same for all lanes")
        else:
            rows = [np.broadcast_to(v, (n, 3)) for v, n in zip(values, counts, strict=True)]
            fields.append(np.concatenate(rows))
    return kind(*fields)


def _stacked(vectors: Sequence[Array | None]) -> Array | None:
    given = [v for v in vectors if v is not None]
    return np.concatenate(given) if given else None
