"""What a scene needs: decided before anything is computed, printed by `--explain`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.resistance import Completion
from qbxstokes.case.load import LoadedCase
from qbxstokes.case.schema import Case
from qbxstokes.quantities import MOTION
from qbxstokes.simulation.from_case import pointed, simulation_of, start_of, times_of
from qbxstokes.simulation.simulation import Simulation

Array = NDArray[np.float64]

# Of a motion alone: the compiled blocks of a sweep, general as they are, would gain nothing.
NO_AXIS = "axis of the body: a sphere moves alike however it lies"
NO_ZEROS = "terms of the equations that are zero in this flow, for this body and its loads"


@dataclass(frozen=True)
class Plan:
    """The work of one motion: scene, instants, what is stored, what is left out and why."""

    simulation: Simulation
    times: Array
    quantities: tuple[str, ...]
    needs: tuple[str, ...]
    skips: tuple[str, ...] = field(default=())

    @property
    def period(self) -> float | None:
        """Jeffery's period in the gradient at the start."""
        return self.simulation.period

    @property
    def bytes_on_disk(self) -> int:
        """Size of the samples in the result file."""
        numbers = 1 + sum(MOTION[name].size for name in self.quantities)
        return 8 * numbers * len(self.times)


def make_plan(loaded: LoadedCase, pushed: bool = False) -> Plan:
    """Plan of `task: motion`; raises CaseError for what the schema alone cannot see.

    pushed: form the resistance, which others that share the body need, in any case.
    """
    case = loaded.case
    with pointed(loaded):
        start_of(loaded).check()
    times = times_of(loaded)
    scene = simulation_of(loaded)
    # Elsewhere an orbit constant would be a number without meaning.
    simple = scene.frame.simple
    quantities = tuple(name for name in MOTION if simple or name != "orbit_constant")
    if case.output.fields is not None:
        for index, name in enumerate(case.output.fields):
            if name not in quantities:
                raise loaded.error(
                    ("output", "fields", index),
                    f"{name} exists in a simple shear only, which the flow at the start is not",
                    "leave it out",
                )
        quantities = tuple(dict.fromkeys(case.output.fields))
    needs, skips = _work(case, scene.kind, loaded.flow.degree, scene.need(pushed).completion)
    return Plan(scene, times, quantities, needs, skips)


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
    skips.append("azimuths and southern half of the body: rotational and mirror symmetry give them")
    if case.hydrodynamics.scheme == "graded" and case.hydrodynamics.expansion is None:
        skips.append("outer expansions: inner ones and the jump give the surface values")
    driven = case.forces.given or case.constraints.given
    if kind == "table":
        skips.append(NO_ZEROS)
        if case.body.aspect_ratio == 1.0:
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
