"""What each task needs: decided before anything is computed, printed by `--explain`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from qbxstokes.bie.rigid import Completion
from qbxstokes.case.load import LoadedCase
from qbxstokes.case.schema import Case
from qbxstokes.errors import ContactError
from qbxstokes.quantities import MOTION, RECORDABLE, STRESS, of_bodies
from qbxstokes.quantity import Quantity
from qbxstokes.runs.field_targets import Targets, targets_of
from qbxstokes.simulation.assembly import CUT_SAMPLES, CUT_STEPS
from qbxstokes.simulation.from_case import end_of, pointed, simulation_of, start_of, times_of
from qbxstokes.simulation.simulation import Simulation
from qbxstokes.typing import Array

_COUPLED_SAMPLES = 51  # of bodies that share a fluid, where the case does not say
# Of a motion alone: the compiled blocks of a sweep, general as they are, would gain nothing.
NO_AXIS = "axis of the body: a sphere moves alike however it lies"
NO_ZEROS = "terms of the equations that are zero in this flow, for this body and its loads"


@dataclass(frozen=True)
class Plan:
    """The work of a task: the body in its flow, what is needed, what is left out and why."""

    simulation: Simulation
    needs: tuple[str, ...]
    skips: tuple[str, ...]
    points: int = field(default=0, kw_only=True)  # of a field


@dataclass(frozen=True)
class MotionPlan(Plan):
    """The work of one motion: instants and stored quantities besides."""

    times: Array
    quantities: tuple[str, ...]

    @property
    def period(self) -> float | None:
        """Jeffery's period in the gradient at the start."""
        return self.simulation.period

    @property
    def bytes_on_disk(self) -> int:
        """Size of the samples in the result file."""
        numbers = 1 + sum(self.about(name).size for name in self.quantities)
        return 8 * numbers * len(self.times)

    @property
    def cuts(self) -> tuple[int, int]:
        """Steps and samples between the cuts at which the run can be resumed, at most."""
        if self.simulation.coupled:
            return 5, 20  # steps of a second or more
        return CUT_STEPS[self.simulation.kind], CUT_SAMPLES

    def about(self, name: str) -> Quantity:
        """What a recorded quantity is, with an axis of bodies where there are several."""
        about, scene = RECORDABLE[name], self.simulation
        return of_bodies(about, len(scene)) if scene.several else about


def plan_of(loaded: LoadedCase) -> Plan:
    """The plan of the case's task; raises CaseError for what the schema alone cannot see."""
    if loaded.space is None and not loaded.case.output.merge:
        raise loaded.error("output.merge", "only a sweep has parts to show", "leave it out")
    if loaded.case.coupled:
        return plan_coupled(loaded)
    makers = {"body": plan_body, "field": plan_field, "rheology": plan_rheology}
    return makers.get(loaded.case.task, make_plan)(loaded)


def make_plan(loaded: LoadedCase, pushed: bool = False) -> MotionPlan:
    """Plan of `task: motion`; raises CaseError for what the schema alone cannot see.

    pushed: form the resistance, which others that share the body need, in any case.
    """
    _placed(loaded)
    times, scene = times_of(loaded), simulation_of(loaded)
    wrong = "exists in a simple shear only, which the flow at the start is not"
    quantities = _stored(loaded, scene.frame.simple, STRESS, wrong, "leave it out")
    needs, skips = _work(loaded.case, scene.kind, loaded.flow.degree, scene.completion(pushed))
    return MotionPlan(scene, needs, skips, times, quantities)


def _placed(loaded: LoadedCase) -> Simulation:
    """The scene at its start, where a body may be; raises CaseError."""
    with pointed(loaded):
        scene = start_of(loaded)
        scene.check()
    return scene


def _stored(
    loaded: LoadedCase, sheared: bool, more: Iterable[str], wrong: str, right: str
) -> tuple[str, ...]:
    """The quantities that are asked for, or all of a motion; raises CaseError for any but `more`.

    sheared: in a simple shear; elsewhere an orbit constant would be a number without meaning.
    """
    usual = tuple(name for name in MOTION if sheared or name != "orbit_constant")
    asked = loaded.case.output.fields
    if asked is None:
        return usual
    for index, name in enumerate(asked):
        if name not in (*usual, *more):
            raise loaded.error(("output", "fields", index), f"{name} {wrong}", right)
    return tuple(dict.fromkeys(asked))


def subject_to_forces(case: Case) -> bool:
    """Whether force and torque enter the motion, or come of it: by inertia, load or constraint."""
    return case.body.stokes_number > 0 or case.forces.given or case.constraints.given


def _work(
    case: Case, kind: str, degree: int | None, completion: Completion | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What is computed and what is not, each with its reason, in a line."""
    massless = case.body.stokes_number == 0
    needs, skips = [], []
    if kind == "every_step":
        needs.append("integral equation solved at every right-hand side (as asked)")
    elif kind == "table":
        needs.append(f"free motion as a table on monomials (flow of degree {degree})")
        skips.append("integral equation at every step: free motion is a linear functional")
        skips.append("background flow on the surface: its derivatives at the centre suffice")
    else:
        needs.append("free motion as weights on the surface grid (flow is not polynomial)")
        skips.append("integral equation at every step: free motion is a linear functional")
    if kind != "every_step":
        skips.append("azimuthal modes above 1: they exert neither force nor torque")
    if kind == "grid":
        needs.append("a grid as fine as the flow asks for wherever the body is")
    skips += _skips_of_body(case)
    driven = case.forces.given or case.constraints.given
    if kind == "table":
        skips.append(NO_ZEROS)
        if case.body.outline.symmetry == "sphere":
            skips.append(NO_AXIS)
    if massless:
        needs.append("position and orientation only: 7 equations (massless body)")
        if not driven:
            skips.append("force and torque: zero at every instant on a massless body")
        if completion is None:
            skips.append("resistance: the mobility problem alone gives the motion without forces")
    else:
        needs.append("resistance, velocities and orientation: 13 equations (inertial body)")
    if driven:
        needs.append("hydrodynamic force and torque, which loads and constraints call forth")
    if case.compare.reference == "none":
        skips.append("comparison with a reference (as asked)")
    return tuple(needs), tuple(skips)


def _skips_of_body(case: Case) -> Iterator[str]:
    """What the operators of a body do without."""
    yield "azimuths and southern half of the body: rotational and mirror symmetry give them"
    if case.hydrodynamics.scheme == "graded" and case.hydrodynamics.expansion is None:
        yield "outer expansions: inner ones and the jump give the surface values"


def plan_body(loaded: LoadedCase) -> Plan:
    """Plan of `task: body`; raises CaseError for what the schema alone cannot see."""
    case, in_flow = loaded.case, loaded.case.flow is not None
    with pointed(loaded):
        scene = start_of(loaded)
        if in_flow:
            scene.check()
    degree = loaded.flow.degree if in_flow else 3
    known = "any flow" if degree is None or degree > 3 else f"flows of degree <= {max(1, degree)}"
    needs = [f"resistance, and the law of free motion in {known}"]
    needs.append("the stresslet in any flow: three adjoint solves, in the modes 0, 1 and 2")
    if in_flow:
        needs.append("velocities of the free body at its place, force and torque on the held one")
    if scene.kind == "every_step":
        needs.append("both by a solution of the integral equation each (as asked)")
    skips = ["motion: nothing is integrated", *_skips_of_body(case)]
    if case.compare.reference == "none":
        skips.append("comparison with closed forms (as asked)")
    return Plan(scene, tuple(needs), tuple(skips))


def plan_coupled(loaded: LoadedCase) -> Plan:
    """Plan with several bodies or a wall; raises CaseError for what the schema cannot see."""
    from qbxstokes.simulation.from_case import coupled_of

    case = loaded.case
    with pointed(loaded):
        scene = coupled_of(loaded)
        try:
            scene.check()
        except ContactError as error:
            key = "bodies" if case.bodies else "start.position"
            raise loaded.error(key, str(error), "a start at which nothing touches") from None
    nodes = scene.suspension.grids(scene.places, scene.flow, clipped=True)
    grids = ", ".join(map(str, nodes[:8])) + (" ..." if len(nodes) > 8 else "")
    needs = [f"grids that follow the gaps: {grids} polar nodes, twice as many azimuthal ones"]
    skips = ("unknowns on the wall: its answer to a flow is known",) if case.wall else ()
    if case.task == "body":
        needs.append(
            f"resistance: {6 * len(nodes)} solves, and as many on coarser grids: the error"
        )
        return Plan(scene, tuple(needs), skips)
    if case.task == "field":
        points, parts = _points(targets_of(loaded, case.field))
        whose = "on the bodies" if case.bodies else "on the body"
        needs += parts + ([f"traction {whose}"] if case.field.surface is not None else [])
        return Plan(scene, tuple(needs), skips, points=points)
    needs.append("a solve for each right-hand side and each sample")
    times = np.linspace(0.0, end_of(loaded), case.time.samples or _COUPLED_SAMPLES)
    if case.time.at is not None:
        times = np.array(case.time.at)
    sheared, known = scene.flow is not None and scene.frame.simple, (*MOTION, "stresslet")
    wrong = "is not there for several bodies or a wall"
    quantities = _stored(loaded, sheared, known, wrong, "stresslet")
    return MotionPlan(scene, tuple(needs), skips, times, quantities)


def plan_rheology(loaded: LoadedCase) -> Plan:
    """Plan of `task: rheology`; raises CaseError for what the schema alone cannot see."""
    case = loaded.case
    section = case.rheology
    scene = _placed(loaded)
    finite = [number for number in section.peclet_number if np.isfinite(number)]
    needs = ["the stresslet of the body: three adjoint solves, in the modes 0, 1 and 2"]
    if finite:
        needs.append("densities of orientations by spherical harmonics, as many as the stress asks")
    if len(finite) < len(section.peclet_number):
        needs.append("orbits without Brownian motion, by closed forms and equal steps of the phase")
    skips = ["motions of single bodies: densities of orientations take their place"]
    return Plan(scene, tuple(needs), (*skips, *_skips_of_body(case)))


def _points(targets: Sequence[Targets]) -> tuple[int, list[str]]:
    """How many points there are, and what is said of them."""
    points = sum(target.size for target in targets)
    parts = ", ".join(f"{target.name} {target.size}" for target in targets)
    return points, [f"fields at {points} points ({parts})"] if points else []


def plan_field(loaded: LoadedCase) -> Plan:
    """Plan of `task: field`; raises CaseError for what the schema alone cannot see."""
    case = loaded.case
    start = _placed(loaded)
    points, parts = _points(targets_of(loaded, case.field))
    needs = [f"integral equation of a body that is {case.field.body}", *parts]
    if case.field.surface is not None:
        needs.append("traction on the body")
    if case.field.streamlines is not None:
        needs.append("streamlines")
    unasked = "stress" not in case.field.quantities and case.field.surface is None
    skips = ("stress: not asked for",) if unasked else ()
    if case.field.tracers is not None:
        needs.append("paths of tracers around a body that stays in this state")
    return Plan(start, tuple(needs), skips, points=points)
