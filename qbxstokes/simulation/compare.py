"""Errors of a motion against closed forms and an independent semi-analytic integration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.functional import BodyModel
from qbxstokes.flows import Flow, PolynomialFlow
from qbxstokes.geometry import rotation
from qbxstokes.motion.equations import Constraints, Loads
from qbxstokes.reference import faxen, jeffery

if TYPE_CHECKING:
    from qbxstokes.simulation.assembly import Assembled
    from qbxstokes.simulation.body import Body

Array = NDArray[np.float64]

# Orbit constants from here on are infinite but for rounding: the axis is in the plane of shear.
_TUMBLING = 1e8

# Relaxation times in a run up to which the explicit reference integration takes seconds.
_STIFFEST = 2e4


@dataclass
class Comparison:
    """Errors by name, each with what it is held against; `note` where there is no reference."""

    errors: dict[str, float] = field(default_factory=dict)
    references: dict[str, str] = field(default_factory=dict)
    note: str = ""

    def add(self, name: str, reference: str, error: float) -> None:
        """Record an error."""
        self.errors[name] = float(error)
        self.references[name] = reference

    @property
    def largest(self) -> float:
        """The largest of the errors, 0 where there is none; NaN counts as infinite."""
        values = np.array([*self.errors.values(), 0.0])
        return float("inf") if np.isnan(values).any() else float(values.max())


def shear_rate(flow: Flow) -> float | None:
    """Rate of the flow u = rate (x2, 0, 0), None for any other flow."""
    polynomial = flow.polynomial
    if polynomial is None or polynomial.degree != 1 or np.any(polynomial.value):
        return None
    gradient = polynomial.gradient_tensor.copy()
    rate = float(gradient[0, 1])
    gradient[0, 1] = 0.0
    return rate if rate and not np.any(gradient) else None


def compare_samples(assembled: Assembled, times: Array, samples: Mapping[str, Array]) -> Comparison:
    """Errors of a motion of one lane from its samples (T, ...) at times (T,).

    samples may hold largest_orbit_drift, that of more samples than these.
    """
    scene = assembled.parts[0]
    v0, w0 = assembled.equations.velocities(0.0, assembled.initial)
    known = {
        "start_position": scene.position[0],
        "start_quaternion": scene.quaternion[0],
        "start_axis": rotation.axis(scene.quaternion[0]),
        "start_velocity": v0[0],
        "start_angular_velocity": w0[0],
    }
    if "largest_orbit_drift" not in samples:
        known["largest_orbit_drift"] = orbit_drift(samples["orbit_constant"])
    model = assembled.hydrodynamics[0].model
    loads, constraints = scene.loads, scene.constraints
    body = scene.body.with_inertia(scene.stokes_number[0], scene.body.inertia)
    return compare(body, scene.flow, model, times, {**samples, **known}, loads, constraints)


def orbit_drift(constants: Array, first: float | None = None) -> Array:
    """Largest |C/C0 - 1| of orbit constants (T,) from the first of them, or a given C0."""
    start = constants[0] if first is None else first
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.abs(constants / start - 1.0)
    return np.asarray(np.max(change, initial=0.0, where=np.isfinite(change)))


def compare(
    body: Body,
    flow: Flow,
    model: BodyModel,
    times: Array,
    samples: Mapping[str, Array],
    loads: Loads | None = None,
    constraints: Constraints | None = None,
) -> Comparison:
    """Hold the samples against every reference that applies to the case."""
    found = Comparison()
    if model.formed_resistance is not None:
        _resistance(found, model)
    polynomial = flow.polynomial
    if polynomial is None:
        found.note = "no closed form for the motion in this flow"
    elif loads is not None or constraints is not None:
        _driven(found, body, polynomial, times, samples, loads, constraints)
    elif not np.any(body.stokes_number):
        _free_motion(found, body, polynomial, samples)
        if polynomial.degree <= 1:
            _jeffery_orbit(found, body, flow, times, samples)
        elif not _chwang_plane(found, body, flow, times, samples):
            found.note = "no closed form for the path in this flow; its velocities are compared"
    elif body.inertia != "both":
        found.note = f"no reference for inertia of {body.inertia} alone"
    elif stiffness(body, times) > _STIFFEST:
        found.note = "reference left out: too stiff for its explicit integration"
    elif polynomial.degree <= 1:
        _inertial_rotation(found, body, polynomial, times, samples)
    elif not _chwang_plane(found, body, flow, times, samples):
        found.note = "no closed form for an inertial body in this flow and orientation"
    return found


def _driven(
    found: Comparison,
    body: Body,
    flow: PolynomialFlow,
    times: Array,
    samples: Mapping[str, Array],
    loads: Loads | None,
    constraints: Constraints | None,
) -> None:
    """Force, torque and velocities of a loaded or held body against the linear laws.

    F = R_t (U - V), M = R_r (Omega - W) with U, Omega from Faxen's laws at the computed place;
    for St = 0 the free parts of the motion are V = U + R_t^-1 F_ext, W = Omega + R_r^-1 M_ext.
    """
    k, axis = body.aspect_ratio, samples["axis"]
    u, omega = faxen.free_motion_polynomial(k, axis, *flow.derivatives(samples["position"]))
    v, w = samples["velocity"], samples["angular_velocity"]
    across, along, turning, spinning = faxen.resistance(k)
    name = "Lamb's, Jeffery's and Faxen's laws"
    force = axial(axis, u - v, across, along)
    torque = axial(axis, omega - w, turning, spinning)
    for label, values, exact, size in (
        ("force", samples["force"], force, across * np.abs(v).max()),
        ("torque", samples["torque"], torque, turning * np.abs(w).max()),
    ):
        scale = max(float(np.abs(exact).max()), float(size))
        if scale > 0.0:
            error = np.linalg.norm(values - exact, axis=-1).max() / scale
            found.add(label, name, error)
    f, m = external(times, samples["orientation"], loads)
    free = constraints or Constraints()
    if not np.any(body.stokes_number):
        if free.velocity is None:
            exact = u + axial(axis, f, 1.0 / across, 1.0 / along)
            found.add("velocity", name, relative(v, exact))
        if free.angular_velocity is None:
            exact = omega + axial(axis, m, 1.0 / turning, 1.0 / spinning)
            if np.any(np.abs(exact) > 0.0):
                found.add("angular_velocity", name, relative(w, exact))
    still = not np.any(m) and np.abs(w).max() <= 1e-14 and flow.degree == 0
    if still and free.velocity is None and np.all(f == f[0]):
        _settling(found, body, times, samples, u, f)


def _settling(
    found: Comparison,
    body: Body,
    times: Array,
    samples: Mapping[str, Array],
    u: Array,
    force: Array,
) -> None:
    """Path of a body that does not turn under a constant force, in a fluid at rest or uniform.

    V approaches U + R^-1 F at the rates R/(St Theta) across and along the axis (Lamb).
    """
    from qbxstokes.reference import inertial

    k, stokes, axis = body.aspect_ratio, float(body.stokes_number), samples["start_axis"]
    across, along, _, _ = faxen.resistance(k)
    end = u[0] + axial(axis, force[0], 1.0 / across, 1.0 / along)
    path = samples["start_position"] + times[:, None] * end
    if stokes > 0:
        lag = samples["start_velocity"] - end
        mass = stokes * inertial.volume(k)
        parallel = (lag @ axis) * axis
        for part, resistance in ((lag - parallel, across), (parallel, along)):
            rate = resistance / mass
            path = path - np.expm1(-rate * times)[:, None] / rate * part
    travelled = np.linalg.norm(path - samples["start_position"], axis=-1).max() or 1.0
    error = np.linalg.norm(samples["position"] - path, axis=-1).max() / travelled
    found.add("position", "Lamb's settling path", error)


def axial(axis: Array, vectors: Array, across: float, along: float) -> Array:
    """The tensor across (I - d d) + along d d applied to vectors (..., 3)."""
    parallel = np.sum(vectors * axis, axis=-1, keepdims=True) * axis
    return np.asarray(across * vectors + (along - across) * parallel)


def external(times: Array, orientation: Array, loads: Loads | None) -> tuple[Array, Array]:
    """External force and torque (T, 3) in space at the orientations (T, 4)."""
    loads = loads or Loads()

    def over_time(vectors: Any) -> Array:
        if callable(vectors):
            return np.array([vectors(t) for t in times.tolist()], dtype=float)
        return np.broadcast_to(np.asarray(vectors, dtype=float), (len(times), 3))

    force, torque, in_body, about_body = (over_time(value) for value in vars(loads).values())
    # Loads: force, torque, body_force, body_torque.
    return (
        force + rotation.to_space(orientation, in_body),
        torque + rotation.to_space(orientation, about_body),
    )


def stiffness(body: Body, times: Array) -> float:
    """Duration over the shortest relaxation time of an inertial body."""
    from qbxstokes.reference import inertial

    k = body.aspect_ratio
    moments = inertial.inertia(k)
    masses = np.array([inertial.volume(k), inertial.volume(k), moments[0], moments[2]])
    rates = np.array(faxen.resistance(k)) / (float(body.stokes_number) * masses)
    return float(rates.max() * times[-1])


def _resistance(found: Comparison, model: BodyModel) -> None:
    exact = faxen.resistance(model.aspect_ratio)
    numbers = vars(model.resistance).values()
    error = max(abs(value / right - 1.0) for value, right in zip(numbers, exact, strict=True))
    found.add("resistance", "Lamb and Jeffery", error)


def relative(values: Array, exact: Array) -> float:
    """Largest distance over the samples, relative to the largest exact vector."""
    scale = np.linalg.norm(exact, axis=-1).max()
    return float(np.linalg.norm(values - exact, axis=-1).max() / (scale or 1.0))


def _free_motion(
    found: Comparison, body: Body, flow: PolynomialFlow, samples: Mapping[str, Array]
) -> None:
    """Velocities at the computed positions and orientations, against the Faxen laws."""
    k, axis = body.aspect_ratio, samples["axis"]
    velocity, spin = faxen.free_motion_polynomial(k, axis, *flow.derivatives(samples["position"]))
    name = "Chwang's and Faxen's laws" if flow.degree > 1 else "Jeffery's formula"
    if np.any(velocity) or np.any(samples["velocity"]):
        found.add("free_velocity", name, relative(samples["velocity"], velocity))
    found.add("free_angular_velocity", name, relative(samples["angular_velocity"], spin))


def _jeffery_orbit(
    found: Comparison, body: Body, flow: Flow, times: Array, samples: Mapping[str, Array]
) -> None:
    """Axis, orbit constant and period of a massless body in a linear flow."""
    k, axis = body.aspect_ratio, samples["axis"]
    start = samples["start_axis"]
    rate = shear_rate(flow)
    if rate is None:
        assert flow.polynomial is not None
        exact = jeffery.axis_in_linear_flow(
            float(times[-1]), k, flow.polynomial.gradient_tensor, start
        )
        error = float(np.linalg.norm(axis[-1] - exact))
        found.add("axis_at_end", "linear orbit equation", error)
        return
    exact = jeffery.axis_at(times, k, start, rate)
    distance = np.linalg.norm(axis - exact, axis=-1)
    found.add("axis", "Jeffery's orbit", distance.max())
    initial = float(jeffery.orbit_constant(k, start))
    if 0.0 < initial < _TUMBLING:
        drift = float(samples["largest_orbit_drift"])
        found.add("orbit_constant_drift", "its conservation", drift)
    measured = measured_period(times, axis, k)
    if measured is not None:
        exact_period = jeffery.period(k, rate)
        found.add("period", "Jeffery's period", abs(measured / exact_period - 1.0))


def measured_period(times: Array, axis: Array, k: float) -> float | None:
    """Period of the axis about e3, from the turns of the projected and stretched axis.

    The angle of (k d1, d2) grows steadily on a Jeffery orbit, so that a part of a turn counts
    right; None for less than half a turn, or an axis along e3.
    """
    if np.hypot(k * axis[:, 0], axis[:, 1]).min() < 1e-8:
        return None
    angle = np.unwrap(np.arctan2(axis[:, 1], k * axis[:, 0]))
    turn = abs(angle[-1] - angle[0])
    if turn < np.pi or np.abs(np.diff(angle)).max() > 0.5 * np.pi:
        return None
    return float(2.0 * np.pi * (times[-1] - times[0]) / turn)


def _inertial_rotation(
    found: Comparison,
    body: Body,
    flow: PolynomialFlow,
    times: Array,
    samples: Mapping[str, Array],
) -> None:
    """Rotation of an inertial body in a linear flow against Jeffery's torque and DOP853."""
    from qbxstokes.reference import inertial

    q0 = samples["start_quaternion"]
    spin = rotation.to_body(q0, samples["start_angular_velocity"])
    grid, last = _with_start(times)
    solution = inertial.linear_flow(
        body.aspect_ratio, float(body.stokes_number), flow.gradient_tensor, q0, grid, spin
    )
    exact = rotation.axis(solution.orientation)
    name = "semi-analytic equations"
    found.add("axis", name, np.linalg.norm(samples["axis"] - exact[last:], axis=-1).max())
    omega = rotation.to_space(solution.orientation, solution.angular_velocity)[last:]
    found.add("angular_velocity", name, relative(samples["angular_velocity"], omega))


def _with_start(times: Array) -> tuple[Array, int]:
    """Times with 0 in front where it is missing, and the index of the first given one."""
    return (times, 0) if times[0] == 0.0 else (np.concatenate([[0.0], times]), 1)


def _chwang_plane(
    found: Comparison, body: Body, flow: Flow, times: Array, samples: Mapping[str, Array]
) -> bool:
    """Chwang's special orientation in u = K (x2^2 + x3^2) e1; False where it does not apply."""
    from qbxstokes.reference import inertial

    polynomial = flow.polynomial
    assert polynomial is not None
    q0, x0 = samples["start_quaternion"], samples["start_position"]
    curvature = 0.5 * float(polynomial.hessian[0, 1, 1])
    bare = polynomial.hessian.copy()
    bare[0, 1, 1] = bare[0, 2, 2] = 0.0
    paraboloid = (
        polynomial.degree == 2
        and not (np.any(bare) or np.any(polynomial.value) or np.any(polynomial.gradient_tensor))
        and not np.any(polynomial.origin)
        and polynomial.hessian[0, 2, 2] == polynomial.hessian[0, 1, 1]
    )
    turn = rotation.matrix(q0)
    v0, w0 = samples["start_velocity"], samples["start_angular_velocity"]
    in_plane = (
        np.abs(turn[:, 1] - [0.0, 0.0, 1.0]).max() < 1e-14
        and abs(x0[2]) < 1e-14
        and abs(v0[2]) < 1e-12
        and np.abs(w0[:2]).max() < 1e-12
    )
    if not (paraboloid and in_plane):
        return False
    phi = float(np.arctan2(turn[1, 0], turn[0, 0]))
    grid, last = _with_start(times)
    k, stokes = body.aspect_ratio, float(body.stokes_number)
    solution = inertial.paraboloid(k, stokes, curvature, x0[:2], phi, grid, v0[:2], float(w0[2]))
    name = "Chwang's semi-analytic equations"
    exact = np.stack([np.sin(solution.phi), -np.cos(solution.phi), 0.0 * solution.phi], -1)[last:]
    found.add("axis", name, np.linalg.norm(samples["axis"] - exact, axis=-1).max())
    path = np.concatenate([solution.position, np.zeros((len(grid), 1))], axis=1)[last:]
    travelled = np.linalg.norm(path - x0, axis=-1).max() or 1.0
    error = np.linalg.norm(samples["position"] - path, axis=-1).max()
    found.add("position", name, error / travelled)
    return True
