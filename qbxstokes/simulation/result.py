"""What an integration gives: a motion sampled at instants."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import SceneError
from qbxstokes.geometry.symmetric import components, symmetric
from qbxstokes.motion.averages import Mean, mean_of
from qbxstokes.quantities import MOTION, RECORDABLE, STRESS, of_event
from qbxstokes.simulation.watching import ending, events_summary, split_columns
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.assembly import Assembled
    from qbxstokes.simulation.lanes import LaneRun

# Numbers that a terminal shows themselves, not their shape.
_FEW = 9
# What a summary tells of a flow.
_FLOW = ("neglected", "recognised", "coarsest_nodes", "finest_nodes")


@dataclass(frozen=True, repr=False)
class Motion:
    """A motion sampled at times (T,): arrays (lanes, T, ...) named as in result files.

    orientation: quaternions (..., 4); position, axis, velocity, angular_velocity, force, torque
    (..., 3), in the space frame; euler_angles (..., 3); orbit_constant (...), NaN where the flow is
    no simple shear. summary: what the integration did. events: by name, arrays by column (of a
    single lane). The axis of lanes is there only where the simulation has one. Lanes that reach the
    edge of their flow have no samples (NaN) from there on; summary["ended"] says when and why.
    """

    time: Array
    position: Array
    orientation: Array
    axis: Array
    velocity: Array
    angular_velocity: Array
    force: Array
    torque: Array
    euler_angles: Array
    orbit_constant: Array
    summary: dict[str, Any] = field(repr=False)
    events: dict[str, dict[str, Array]] = field(repr=False)
    _assembled: Assembled = field(repr=False)
    _states: Array = field(repr=False)

    @classmethod
    def of(
        cls, assembled: Assembled, trajectory: Any, watch: Any, run: LaneRun | None = None
    ) -> Motion:
        """From the states of an integration; run: of several lanes."""
        times, states = trajectory.times, trajectory.states
        wanted = tuple(MOTION)
        found = assembled.observe(times, states, wanted) if run is None else run.samples(wanted)
        lanes = assembled.parts[0].lanes if len(assembled.parts) == 1 else (states.shape[1],)

        def arranged(values: Array) -> Array:
            turned = values.swapaxes(0, 1)
            return np.ascontiguousarray(turned).reshape(*lanes, *turned.shape[1:])

        events: dict[str, dict[str, Array]] = {}
        if watch is not None:
            for name, rows in watch.take().items():
                events[name] = split_columns(rows, of_event(name))
        summary = {
            **integration_facts(trajectory),
            "expected_error": max(
                assembled.expected_errors(float(times[-1]), trajectory.checkpoint.reachable),
                key=lambda error: error["total"],
            ),
            "model_error_estimate": max(h.model.error_estimate for h in assembled.hydrodynamics),
            **{k: v for k, v in assembled.hydrodynamics[0].report().items() if k in _FLOW},
            **({} if watch is None else {"events": events_summary(watch)}),
        }
        if run is not None and run.ended:
            summary["ended"] = {lane: ending(contact) for lane, contact in run.ended.items()}
        values = {name: arranged(found[name]) for name in MOTION}
        return cls(
            times, **values, summary=summary, events=events, _assembled=assembled, _states=states
        )

    def __repr__(self) -> str:
        lanes = self.position.shape[:-2]
        many = f"{math.prod(lanes)} lanes, " if lanes else ""
        happened = [f"{len(held['time'])} {name}" for name, held in self.events.items()]
        heading = (
            f"Motion: {many}{len(self.time)} instants, t = {self.time[0]:g} to "
            f"{self.time[-1]:g}; {self.steps} steps by {self.summary['method']}"
        )
        if happened:
            heading += f"; events: {', '.join(happened)}"
        names = ("time", *MOTION)
        return shown(heading, {name: getattr(self, name) for name in names}, self.summary)

    def plot(self, kind: str = "", ax: Any = None, *, lane: int = 0) -> Any:
        """A picture as of a result file: see `Result.plot`; lane: which, of several.

        kind: orbit, rotation, constant, path, velocity, loads, overview, or a quantity's name, such
        as particle_stress.
        """
        from qbxstokes.plots.pictures import plot

        count = math.prod(self.position.shape[:-2])
        if not 0 <= lane < count:
            raise SceneError("lane", f"is {lane}", f"a number from 0 to {count - 1}")
        return plot(_Drawn(self, lane, kind), kind, ax, {})

    @cached_property
    def sampling(self) -> dict[str, float]:
        """What the spacing of a series' samples leaves of axis and position at the end (or {}).

        By motions on all samples and on every other one, when first asked.
        """
        return self._assembled.sampling(float(self.time[-1]))

    @cached_property
    def stresslet(self) -> Array:
        """Stresslets (lanes, T, 3, 3), space frame, units of mu c^3/tau; computed when asked."""
        return self._stress["stresslet"]

    @cached_property
    def particle_stress(self) -> Array:
        """Stress (lanes, T, 3, 3) over volume fraction, mu and rate sqrt(2 E:E) at the centre.

        Its inertial parts, which it contains, are acceleration_stress and reynolds_stress.
        """
        return self._stress["particle_stress"]

    @cached_property
    def acceleration_stress(self) -> Array:
        """The part of particle_stress from the acceleration of the particle's mass."""
        return self._stress["acceleration_stress"]

    @cached_property
    def reynolds_stress(self) -> Array:
        """The part of particle_stress from the particle's motion past the mean flow."""
        return self._stress["reynolds_stress"]

    @cached_property
    def brownian_stress(self) -> Array:
        """The part of particle_stress from rotary Brownian motion."""
        return self._stress["brownian_stress"]

    @cached_property
    def _stress(self) -> dict[str, Array]:
        found = self._assembled.observe(self.time, self._states, tuple(STRESS))
        lanes = self.position.shape[:-2]
        return {
            name: np.moveaxis(symmetric(found[name]), 0, 1).reshape(*lanes, -1, 3, 3)
            for name in STRESS
        }

    @property
    def steps(self) -> int:
        """Steps that the integrator took."""
        return int(self.summary["steps"])

    def between(self, begin: float, end: float) -> Motion:
        """The samples from begin to end, both included: averages over a window of the time."""
        first, last = np.searchsorted(self.time, begin), np.searchsorted(self.time, end, "right")
        lanes = (slice(None),) * (self.position.ndim - 2)
        values = {name: getattr(self, name)[(*lanes, slice(first, last))] for name in MOTION}
        states = self._states[first:last]
        return replace(self, time=self.time[first:last], _states=states, **values)

    def averages(self, discard: float = 0.0) -> dict[str, Array]:
        """Averages over the whole half-turns after the first part `discard` of the time.

        half_turns, period, period_change, rotation_rate, orbit_constant_start and _end, orbit_drift
        (lanes,), mean_velocity and velocity_change (lanes, 3): see `motion.averages.turn_averages`.
        """
        samples = {
            name: self._rows(getattr(self, name))
            for name in ("position", "axis", "velocity", "angular_velocity")
        }
        found = self._assembled.averages(self.time, samples, discard)
        lanes = self.position.shape[:-2]
        return {name: values.reshape((*lanes, *values.shape[1:])) for name, values in found.items()}

    def mean(self, name: str, discard: float = 0.0) -> Mean:
        """Mean of a quantity over whole turns, and over the lanes, with its errors.

        name: such as "particle_stress"; discard: the first part of the time, which is left out.
        Where no whole turn is known the mean is over all of the time.

        >>> import numpy as np, qbxstokes as qs
        >>> scene = qs.Simulation(
        ...     qs.Body(0.2), qs.flow("shear"), orientation=[[1, 0, 1], [1, 0, 0]]
        ... )
        >>> stress = scene.integrate(np.linspace(0.0, scene.period, 201)).mean("particle_stress")
        >>> np.round(stress.each[:, 0, 1], 4)
        array([3.1736, 3.5436])
        """
        if name not in RECORDABLE:
            raise SceneError("name", f"is {name!r}", ", ".join(RECORDABLE))
        period = np.asarray(self.averages(discard)["period"]).ravel()
        found = mean_of(self.time, self._rows(getattr(self, name)), period, discard)
        lanes = self.position.shape[:-2]
        return replace(found, each=found.each.reshape((*lanes, *found.each.shape[1:])))

    def errors(self) -> dict[str, float]:
        """Largest errors against closed forms and independent integrations, by name.

        Of a single lane; empty where nothing is known (`comparison` says why).
        """
        return self.comparison().errors

    def comparison(self) -> Any:
        """Errors with what they are held against, and a note where there is no reference."""
        from qbxstokes.simulation.compare import compare_samples

        values: Mapping[str, Array] = {
            name: self._rows(getattr(self, name))[:, 0] for name in MOTION
        }
        return compare_samples(self._assembled, self.time, values)

    def _rows(self, values: Array) -> Array:
        """Values (lanes, T, ...) as (T, n, ...)."""
        lanes = self.position.ndim - 2
        flat = values.reshape(-1, *values.shape[lanes:])
        return np.ascontiguousarray(np.moveaxis(flat, 0, 1))


class _Drawn:
    """One lane of a motion, as pictures take a result."""

    path, task = Path("motion"), "motion"

    def __init__(self, motion: Motion, lane: int, kind: str) -> None:
        rows = {name: motion._rows(getattr(motion, name))[:, lane] for name in MOTION}
        if kind in STRESS:  # computed where it is asked for alone
            rows[kind] = components(motion._rows(getattr(motion, kind))[:, lane])
        self.arrays: Mapping[str, Any] = {"time": motion.time, **rows}
        self.attributes = {name: {"units": RECORDABLE[name].units} for name in rows}
        self.summary = motion.summary
        self.provenance: dict[str, Any] = {}
        self.groups: dict[str, dict[str, Any]] = {}


def integration_facts(trajectory: Any) -> dict[str, Any]:
    """What an integration did, in numbers."""
    record = trajectory.checkpoint
    return {
        "method": record.method,
        "steps": record.steps,
        "rejected": record.rejections,
        "rhs_evaluations": record.evaluations,
        "jacobians": record.jacobians,
        "local_tolerance": record.local_tolerance,
        "reachable_error": record.reachable,
        "quaternion_norm_drift": record.norm_drift,
        **({"longest_step": trajectory.longest_step} if trajectory.longest_step else {}),
        **({"flow_samples": trajectory.flow_samples} if trajectory.flow_samples else {}),
        **({"changed": record.changed} if record.changed else {}),
    }


def shown(heading: str, arrays: Mapping[str, ArrayLike], summary: Mapping[str, Any]) -> str:
    """The heading, short arrays with their numbers, the shapes of others, names in the summary."""
    few: list[str] = []
    shapes: dict[tuple[int, ...], list[str]] = {}
    for name, value in arrays.items():
        found = np.asarray(value)
        if found.ndim < 2 and found.size <= _FEW:
            few.append(f"{name} {' '.join(f'{number:.6g}' for number in found.ravel())}")
        else:
            shapes.setdefault(found.shape, []).append(name)
    whole = [f"{', '.join(names)} {shape}" for shape, names in shapes.items()]
    told = [f"summary: {', '.join(summary)}"] if summary else []
    return "\n  ".join([f"<{heading}>", *few, *whole, *told])
