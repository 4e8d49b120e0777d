"""What a scene needs: decided before anything is computed, printed by `--explain`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.bie.resistance import Completion
from qbxstokes.case.load import LoadedCase
from qbxstokes.case.schema import Case
from qbxstokes.errors import CaseError, FlowError
from qbxstokes.flows.check import check_regular, check_singularities, check_stokesian
from qbxstokes.geometry import rotation
from qbxstokes.io.results import MOTION_FIELDS, check_writable, free_name
from qbxstokes.motion.averages import ShearFrame
from qbxstokes.runs.field_targets import chosen_instants, targets_of

Array = NDArray[np.float64]

# Of a motion alone: the compiled blocks of a sweep, general as they are, would gain nothing.
NO_AXIS = "axis of the body: a sphere moves alike however it lies"
NO_ZEROS = "terms of the equations that are zero in this flow, for this body and its loads"


@dataclass(frozen=True)
class Plan:
    """The work of one motion: instants, start, which functional, and what is left out and why."""

    times: Array
    period: float | None
    frame: ShearFrame
    position: Array
    quaternion: Array
    hydrodynamics: str  # "table", "grid" or "every_step"
    completion: Completion | None  # of the resistance problem, None where it is left out
    output: Path
    fields: tuple[str, ...]
    needs: tuple[str, ...]
    skips: tuple[str, ...] = field(default=())

    @property
    def bytes_on_disk(self) -> int:
        """Size of the samples in the result file."""
        numbers = 1 + sum(math.prod(MOTION_FIELDS[name].shape) for name in self.fields)
        return 8 * numbers * len(self.times)


def make_plan(loaded: LoadedCase, overwrite: bool = False, pushed: bool = False) -> Plan:
    """Plan of `task: motion`; raises CaseError for what the schema alone cannot see.

    pushed: form the resistance, which others that share the body need, in any case.
    """
    case, flow = loaded.case, loaded.flow
    assert case.time is not None  # the schema requires it for this task
    output = result_path(loaded)
    overwrite = overwrite or case.output.overwrite
    try:
        check_writable(output, overwrite)
    except CaseError as error:
        raise loaded.error("output.file", str(error)) from None
    if not overwrite:
        output = free_name(output)
    position = np.array(case.start.position)
    quaternion = start_quaternion(case)
    check_flow(loaded, position, quaternion)
    gradient = flow.gradient(position)
    frame = ShearFrame.of(gradient)
    # Elsewhere an orbit constant would be a number without meaning.
    fields = tuple(name for name in MOTION_FIELDS if frame.simple or name != "orbit_constant")
    if case.output.fields is not None:
        for index, name in enumerate(case.output.fields):
            if name not in MOTION_FIELDS:
                raise loaded.error(
                    ("output", "fields", index),
                    f"{name!r} is not a quantity of a motion",
                    f"one of {', '.join(MOTION_FIELDS)}",
                )
            if name not in fields:
                raise loaded.error(
                    ("output", "fields", index),
                    f"{name} exists in a simple shear only, which the flow at the start is not",
                    "leave it out",
                )
        fields = tuple(dict.fromkeys(case.output.fields))
    period = rotation_period(gradient, case.body.aspect_ratio)
    if case.time.periods is not None and period is None:
        raise loaded.error(
            "time.periods",
            "the flow's gradient at the start turns no axis around, so there is no period",
            "give time.end instead",
        )
    times = _times(case, period)
    if case.field is not None:
        # What is wrong with them is told before anything is computed.
        chosen_instants(loaded, times)
        targets_of(loaded, case.field)
    kind = "every_step" if case.hydrodynamics.solve == "every_step" else "grid"
    if kind == "grid" and flow.degree is not None and flow.degree <= 3:
        kind = "table"
    completion = case.hydrodynamics.completion
    if completion is None and (pushed or subject_to_forces(case)):
        completion = "surface"
    needs, skips = _work(case, kind, flow.degree, completion)
    return Plan(
        times=times,
        period=period,
        frame=frame,
        position=position,
        quaternion=quaternion,
        hydrodynamics=kind,
        completion=completion,
        output=output,
        fields=fields,
        needs=needs,
        skips=skips,
    )


def subject_to_forces(case: Case) -> bool:
    """Whether force and torque enter the motion, or come of it: by inertia, load or constraint."""
    return case.body.stokes_number > 0 or case.forces.given or case.constraints.given


def result_path(loaded: LoadedCase) -> Path:
    """The result file that the case asks for."""
    return Path(loaded.case.output.file or f"{loaded.path.stem}.h5")


def start_quaternion(case: Case) -> Array:
    """Unit quaternion (4,) of the start, from whichever form the case gives."""
    form = case.start.orientation
    if form.quaternion is not None:
        return rotation.normalize(np.array(form.quaternion))
    if form.axis is not None:
        return rotation.from_axis(np.array(form.axis))
    if form.orbit is not None:
        k, orbit = case.body.aspect_ratio, form.orbit
        return rotation.from_axis(orbit_axis(k, orbit.constant, orbit.phase))
    assert form.euler is not None  # the schema lets exactly one form through
    return rotation.from_euler(form.euler.phi, form.euler.theta, form.euler.psi)


def orbit_axis(aspect_ratio: ArrayLike, constant: ArrayLike, phase: ArrayLike) -> Array:
    """Axis (..., 3) on the Jeffery orbit C in the shear (x2, 0, 0), any length but zero.

    (C cos p, -C k sin p, 1), and its limit (cos p, -k sin p, 0) for infinite C; the phase p of a
    massless body grows by 2 pi in a period (Jeffery 1922, eqs. 48 f.).
    """
    k, c, p = (np.asarray(value, dtype=float) for value in (aspect_ratio, constant, phase))
    # Both divided by 1 + C, so that tumbling needs no case of its own but the number itself.
    part = np.where(np.isinf(c), 1.0, c / (1.0 + np.where(np.isinf(c), 0.0, c)))
    return np.stack(np.broadcast_arrays(part * np.cos(p), -k * part * np.sin(p), 1.0 - part), -1)


def check_flow(loaded: LoadedCase, position: Array, quaternion: Array) -> None:
    """Refuse a flow that is not Stokesian near the body, or singular in it at the start."""
    k = loaded.case.body.aspect_ratio
    try:
        check_singularities(loaded.flow, position, rotation.axis(quaternion), k)
    except FlowError as error:
        raise loaded.error(
            "start.position", str(error), "move the body or the singular point"
        ) from None
    try:
        check_stokesian(loaded.flow, position, radius=2.0 * max(1.0, k))
    except FlowError as error:
        raise loaded.error(("flow", *error.key), str(error)) from None
    if loaded.flow.singular_points_known:
        return
    try:
        check_regular(loaded.flow, position, rotation.axis(quaternion), k)
    except FlowError as error:
        raise loaded.error("flow", str(error), "a start.position away from there") from None


def rotation_period(gradient: Array, aspect_ratio: float) -> float | None:
    """Period of a free spheroid's axis in a linear flow, None where it comes to rest.

    The axis follows the linear system dd/dt = (W + lambda E) d up to its length, with
    lambda = (1 - k^2)/(1 + k^2) (Bretherton 1962, J. Fluid Mech. 14, eq. 15 f.); a complex pair of
    eigenvalues +-i omega + sigma makes it turn with period 2 pi/omega. In a shear of rate 1 this
    is Jeffery's 2 pi (k + 1/k).
    """
    k = aspect_ratio
    shape = (1.0 - k * k) / (1.0 + k * k)
    largest = float(np.abs(gradient).max())
    if not largest > 0.0:
        return None
    gradient = gradient / largest  # so that no rate is too large or too small for its square
    strain, spin = 0.5 * (gradient + gradient.T), 0.5 * (gradient - gradient.T)
    if not np.any(spin):
        return None
    # omega^2 = -(1/2) tr (W + lambda E)^2 when the third eigenvalue vanishes, which is exact for
    # plane flows where thin bodies make the eigenvalue problem ill-conditioned.
    system = spin + shape * strain
    if abs(np.linalg.det(system)) <= 1e-14 * np.abs(system).max() ** 3:
        squared = 0.5 * float(np.sum(spin * spin) - shape**2 * np.sum(strain * strain))
        omega = math.sqrt(max(0.0, squared))
    else:
        omega = float(np.abs(np.linalg.eigvals(system).imag).max())
    return 2.0 * math.pi / omega / largest if omega > 0.0 else None


def _times(case: Case, period: float | None) -> Array:
    """The instants to store; the integration starts at 0 whether or not 0 is one of them."""
    time = case.time
    assert time is not None
    if time.at is not None:
        return np.array(time.at)
    end = time.end if time.end is not None else (time.periods or 0.0) * (period or 0.0)
    return np.linspace(0.0, end, time.samples)


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
