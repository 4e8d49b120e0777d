"""Errors of a motion against closed forms and an independent semi-analytic integration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.bie.functional import BodyModel, Resistance
from qbxstokes.flows import Flow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import Constraints, Loads
from qbxstokes.reference import faxen, inertial, jeffery
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.assembly import Assembled


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
    def largest(self) -> float | None:
        """The largest of the errors, None where nothing is compared; NaN counts as infinite."""
        if not self.errors:
            return None
        values = np.array([*self.errors.values()])
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


def orbit_drift(constants: Array, first: float | None = None) -> Array:
    """Largest |C/C0 - 1| of orbit constants (T,) from the first of them, or a given C0."""
    start = constants[0] if first is None else first
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.abs(constants / start - 1.0)
    return np.asarray(np.max(change, initial=0.0, where=np.isfinite(change)))


def compare_samples(assembled: Assembled, times: Array, samples: Mapping[str, Array]) -> Comparison:
    """Errors of a motion of one lane from its samples (T, ...) at times (T,).

    samples may hold largest_orbit_drift, that of more samples than these.
    """
    return _References(assembled, times, samples).found


class _References:
    """Holds the samples of a motion against every reference that applies to its scene."""

    def __init__(self, assembled: Assembled, times: Array, samples: Mapping[str, Array]) -> None:
        scene = assembled.parts[0]
        self.found, self.times, self.samples = Comparison(), times, samples
        shape, self.stokes = scene.body.shape, float(scene.stokes_number[0])
        if not isinstance(shape, Spheroid):
            self.found.note = f"no closed forms for a {shape}"
            return
        self.k, self.arm = shape.aspect_ratio, shape.radius
        self.flow, self.loads = scene.flow, scene.loads
        self.bound = scene.constraints or Constraints()
        self.x0, self.q0 = scene.position[0], scene.quaternion[0]
        self.axis0 = rotation.axis(self.q0)
        v0, w0 = assembled.equations.velocities(0.0, assembled.initial)
        self.v0, self.w0 = v0[0], w0[0]
        model = assembled.hydrodynamics[0].model
        if model.formed_resistance is not None:
            self._resistance(model)
        polynomial, inertia = self.flow.polynomial, scene.body.inertia
        if polynomial is None:
            self.found.note = "no closed form for the motion in this flow"
            return
        self.polynomial = polynomial
        linear = polynomial.degree <= 1
        if scene.loads is not None or scene.constraints is not None:
            self._driven()
        elif not self.stokes:
            self._free_motion()
            if linear:
                self._jeffery_orbit()
            elif not self._chwang_plane():
                self.found.note = (
                    "no closed form for the path in this flow; its velocities are compared"
                )
        elif inertia != "both":
            self.found.note = f"no reference for inertia of {inertia} alone"
        elif self._stiffness() > _STIFFEST:
            self.found.note = "reference left out: too stiff for its explicit integration"
        elif linear:
            self._inertial_rotation()
        elif not self._chwang_plane():
            self.found.note = "no closed form for an inertial body in this flow and orientation"

    @property
    def _rate(self) -> float:
        """Largest velocity gradient on the way: times the body's radius what velocities stand for.

        Those of a body that the flow leaves at rest are rounding.
        """
        gradient = self.polynomial.gradient(self.samples["position"])
        return float(np.linalg.norm(gradient, axis=(-2, -1)).max())

    def _resistance(self, model: BodyModel) -> None:
        exact = Resistance(*faxen.resistance(self.k)).matrix
        ratio = np.diag(model.resistance.matrix) / np.diag(exact)
        error = float(np.abs(ratio - 1.0).max())
        self.found.add("resistance", "Lamb and Jeffery", error)

    def _driven(self) -> None:
        """Force, torque and velocities of a loaded or held body against the linear laws.

        F = R_t (U - V), M = R_r (Omega - W) with U, Omega from Faxen's laws at the computed place;
        for St = 0 the free parts of the motion are V = U + R_t^-1 F_ext, W = Omega + R_r^-1 M_ext.
        """
        axis, flow = self.samples["axis"], self.polynomial
        u, omega = faxen.free_motion_polynomial(
            self.k, axis, *flow.derivatives(self.samples["position"])
        )
        v, w = self.samples["velocity"], self.samples["angular_velocity"]
        across, along, turning, spinning = faxen.resistance(self.k)
        name = "Lamb's, Jeffery's and Faxen's laws"
        force = axial(axis, u - v, across, along)
        torque = axial(axis, omega - w, turning, spinning)
        for label, values, exact, size in (
            ("force", self.samples["force"], force, across * np.abs(v).max()),
            ("torque", self.samples["torque"], torque, turning * np.abs(w).max()),
        ):
            scale = max(float(np.abs(exact).max()), float(size))
            if scale > 0.0:
                error = np.linalg.norm(values - exact, axis=-1).max() / scale
                self.found.add(label, name, error)
        f, m = external(self.times, self.samples["orientation"], self.loads)
        if not self.stokes:
            if self.bound.velocity is None:
                exact = u + axial(axis, f, 1.0 / across, 1.0 / along)
                error = relative(v, exact, self._rate * self.arm)
                self.found.add("velocity", name, error)
            if self.bound.angular_velocity is None:
                exact = omega + axial(axis, m, 1.0 / turning, 1.0 / spinning)
                if np.any(np.abs(exact) > 0.0):
                    self.found.add("angular_velocity", name, relative(w, exact, self._rate))
        still = not np.any(m) and np.abs(w).max() <= 1e-14 and flow.degree == 0
        if still and self.bound.velocity is None and np.all(f == f[0]):
            self._settling(u, f)

    def _settling(self, u: Array, force: Array) -> None:
        """Path of a body that does not turn under a constant force, in a fluid at rest or uniform.

        V approaches U + R^-1 F at the rates R/(St Theta) across and along the axis (Lamb).
        """
        axis = self.axis0
        across, along, _, _ = faxen.resistance(self.k)
        end = u[0] + axial(axis, force[0], 1.0 / across, 1.0 / along)
        path = self.x0 + self.times[:, None] * end
        if self.stokes > 0:
            lag = self.v0 - end
            mass = self.stokes * inertial.volume(self.k)
            parallel = (lag @ axis) * axis
            for part, resistance in ((lag - parallel, across), (parallel, along)):
                rate = resistance / mass
                path = path - np.expm1(-rate * self.times)[:, None] / rate * part
        travelled = np.linalg.norm(path - self.x0, axis=-1).max() or 1.0
        error = np.linalg.norm(self.samples["position"] - path, axis=-1).max() / travelled
        self.found.add("position", "Lamb's settling path", error)

    def _free_motion(self) -> None:
        """Velocities at the computed positions and orientations, against the Faxen laws."""
        axis, flow = self.samples["axis"], self.polynomial
        velocity, spin = faxen.free_motion_polynomial(
            self.k, axis, *flow.derivatives(self.samples["position"])
        )
        name = "Chwang's and Faxen's laws" if flow.degree > 1 else "Jeffery's formula"
        if np.any(velocity) or np.any(self.samples["velocity"]):
            error = relative(self.samples["velocity"], velocity, self._rate * self.arm)
            self.found.add("free_velocity", name, error)
        error = relative(self.samples["angular_velocity"], spin, self._rate)
        self.found.add("free_angular_velocity", name, error)

    def _jeffery_orbit(self) -> None:
        """Axis, orbit constant and period of a massless body in a linear flow."""
        k, axis = self.k, self.samples["axis"]
        start = self.axis0
        rate = shear_rate(self.flow)
        if rate is None:
            exact = jeffery.axis_in_linear_flow(
                float(self.times[-1]), k, self.polynomial.gradient_tensor, start
            )
            error = float(np.linalg.norm(axis[-1] - exact))
            self.found.add("axis_at_end", "linear orbit equation", error)
            return
        exact = jeffery.axis_at(self.times, k, start, rate)
        distance = np.linalg.norm(axis - exact, axis=-1)
        self.found.add("axis", "Jeffery's orbit", distance.max())
        initial = float(jeffery.orbit_constant(k, start))
        if 1.0 / _TUMBLING < initial < _TUMBLING:
            drift = self.samples.get("largest_orbit_drift")
            if drift is None:
                drift = orbit_drift(self.samples["orbit_constant"])
            self.found.add("orbit_constant_drift", "its conservation", float(drift))
        measured = measured_period(self.times, axis, k)
        if measured is not None:
            exact_period = jeffery.period(k, rate)
            self.found.add("period", "Jeffery's period", abs(measured / exact_period - 1.0))

    def _stiffness(self) -> float:
        """Duration over the shortest relaxation time of an inertial body."""
        moments = inertial.inertia(self.k)
        masses = np.array([inertial.volume(self.k)] * 2 + [moments[0], moments[2]])
        rates = np.array(faxen.resistance(self.k)) / (self.stokes * masses)
        return float(rates.max() * self.times[-1])

    def _inertial_rotation(self) -> None:
        """Rotation of an inertial body in a linear flow against Jeffery's torque and DOP853."""
        spin = rotation.to_body(self.q0, self.w0)
        grid, last = _with_start(self.times)
        solution = inertial.linear_flow(
            self.k, self.stokes, self.polynomial.gradient_tensor, self.q0, grid, spin
        )
        exact = rotation.axis(solution.orientation)
        name = "semi-analytic equations"
        error = np.linalg.norm(self.samples["axis"] - exact[last:], axis=-1).max()
        self.found.add("axis", name, error)
        omega = rotation.to_space(solution.orientation, solution.angular_velocity)[last:]
        self.found.add("angular_velocity", name, relative(self.samples["angular_velocity"], omega))

    def _chwang_plane(self) -> bool:
        """Chwang's special orientation in u = K (x2^2 + x3^2) e1; False where it does not apply."""
        polynomial, x0, v0, w0 = self.polynomial, self.x0, self.v0, self.w0
        curvature = 0.5 * float(polynomial.hessian[0, 1, 1])
        bare = polynomial.hessian.copy()
        bare[0, 1, 1] = bare[0, 2, 2] = 0.0
        paraboloid = (
            polynomial.degree == 2
            and not (np.any(bare) or np.any(polynomial.value) or np.any(polynomial.gradient_tensor))
            and not np.any(polynomial.origin)
            and polynomial.hessian[0, 2, 2] == polynomial.hessian[0, 1, 1]
        )
        turn = rotation.matrix(self.q0)
        in_plane = (
            np.abs(turn[:, 1] - [0.0, 0.0, 1.0]).max() < 1e-14
            and abs(x0[2]) < 1e-14
            and abs(v0[2]) < 1e-12
            and np.abs(w0[:2]).max() < 1e-12
        )
        if not (paraboloid and in_plane):
            return False
        phi = float(np.arctan2(turn[1, 0], turn[0, 0]))
        grid, last = _with_start(self.times)
        solution = inertial.paraboloid(
            self.k, self.stokes, curvature, x0[:2], phi, grid, v0[:2], float(w0[2])
        )
        name = "Chwang's semi-analytic equations"
        turned = solution.phi[last:]
        exact = np.stack([np.sin(turned), -np.cos(turned), 0.0 * turned], -1)
        self.found.add("axis", name, np.linalg.norm(self.samples["axis"] - exact, axis=-1).max())
        path = np.concatenate([solution.position, np.zeros((len(grid), 1))], axis=1)[last:]
        travelled = np.linalg.norm(path - x0, axis=-1).max() or 1.0
        error = np.linalg.norm(self.samples["position"] - path, axis=-1).max()
        self.found.add("position", name, error / travelled)
        return True


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


def relative(values: Array, exact: Array, least: float = 0.0) -> float:
    """Largest distance over the samples, relative to the largest exact vector, `least` at least."""
    scale = max(float(np.linalg.norm(exact, axis=-1).max()), least)
    return float(np.linalg.norm(values - exact, axis=-1).max() / (scale or 1.0))


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


def _with_start(times: Array) -> tuple[Array, int]:
    """Times with 0 in front where it is missing, and the index of the first given one."""
    return (times, 0) if times[0] == 0.0 else (np.concatenate([[0.0], times]), 1)
