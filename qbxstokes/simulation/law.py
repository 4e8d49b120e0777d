"""The hydrodynamics of one body without a motion: its law, its state in a flow, its errors."""

from typing import Any

import numpy as np

from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.reference import faxen, stress
from qbxstokes.simulation.assembly import assemble
from qbxstokes.simulation.compare import Comparison
from qbxstokes.simulation.hydrodynamics import hydrodynamics_of, true_error
from qbxstokes.simulation.simulation import ORIGIN, Simulation
from qbxstokes.typing import Array

# Nodes of the reference's mean over the surface, and how many times the flow's own.
_REFERENCE_NODES, _FINER = 40, 2
_IN_FLOW = ("free_velocity", "free_angular_velocity", "held_force", "held_torque")


class Law:
    """The numbers of a formed body; in_flow: for the scene's flow, with what it does in there.

    Else for flows of degree <= 3. formed: with the resistance.
    """

    def __init__(self, scene: Simulation, in_flow: bool) -> None:
        self.scene, self.in_flow = scene, in_flow
        self.formed = hydrodynamics_of(scene, pushed=True, degree=None if in_flow else 3)

    @property
    def arrays(self) -> dict[str, Array]:
        """The quantities of `quantities.BODY` by name; those in a flow where there is one."""
        model, numbers = self.formed.model, self._numbers
        found = {
            "resistance": model.resistance.matrix,
            "mobility": model.resistance.mobility,
            "linear": np.array(model.faxen.linear),
            "quadratic": model.faxen.quadratic,
            "cubic": model.faxen.cubic,
            "stresslet_numbers": np.array(list(numbers.values())),
            "kim_karrila": np.array([numbers[n] for n in ("S0", "held", "S2")]) / self._unit,
        }
        if self.in_flow:
            found |= dict(zip(_IN_FLOW, (*self._moving(None), *self._moving(ORIGIN)), strict=True))
        return found

    @property
    def _numbers(self) -> dict[str, float]:
        """S0, S1, S2 and the held S1."""
        model, free = self.formed.model, self.scene.body.stress.numbers.tolist()
        numbers = dict(zip(("S0", "S1", "S2"), free, strict=True))
        torque = 0.5 * model.resistance.rotation_transverse * model.faxen.linear**2
        return numbers | {"held": numbers["S1"] + torque}

    @property
    def _unit(self) -> float:
        """Stresslet of the sphere around the body in a unit strain."""
        return 20.0 * np.pi / 3.0 * self.scene.body.shape.radius**3

    def _moving(self, velocity: Any) -> tuple[Array, Array]:
        """Velocities (3,) of the free body (velocity None), or force and torque on the held one."""
        scene = self.scene
        body = scene.body.with_inertia(0.0 if velocity is None else 1.0)
        placed = Simulation(
            body,
            scene.flow,
            position=scene.position[0],
            orientation=scene.quaternion[0],
            velocity=velocity,
            angular_velocity=velocity,
        )
        assembled = assemble([placed], maker=lambda *_: self.formed)
        equations = assembled.equations
        ask = equations.velocities if velocity is None else equations.force_torque
        one, other = ask(0.0, assembled.initial)
        return np.array(one[0]), np.array(other[0])

    def errors(self, arrays: dict[str, Array]) -> Comparison:
        """Errors of the motion against the laws of Lamb, Jeffery and Faxen."""
        flow, shape = self.scene.flow, self.scene.body.shape
        degree = self.scene.carrier.degree if self.in_flow else None
        degree = 3 if degree is None else min(3, max(1, degree))
        found = Comparison()
        if not isinstance(shape, Spheroid):
            found.note = f"no closed forms for a {shape}"
            return found
        found.add("law", "Lamb, Jeffery and Faxen", true_error(self.formed.model, degree))
        if self.in_flow:
            k = shape.aspect_ratio
            nodes, _ = self.formed.facts.get("flow_nodes", (0, 0))
            place = rotation.matrix(self.scene.quaternion[0]), self.scene.position[0]
            order = max(_REFERENCE_NODES, _FINER * nodes)
            exact = (
                *faxen.free_motion(k, *place, flow.velocity, order),
                *faxen.fixed_force_torque(k, *place, flow.velocity, order),
            )
            for name, values, size in zip(_IN_FLOW, exact, self._sizes(), strict=True):
                # What vanishes by symmetry has no size of its own: it is held against the flow's.
                scale = max(float(np.linalg.norm(values)), size)
                error = float(np.linalg.norm(arrays[name] - values)) / (scale or 1.0)
                found.add(name, "Brenner's Faxen laws", error)
        return found

    def stresslet_error(self) -> float:
        """Largest relative error of S0, S1, S2 and the held S1 against Kim and Karrila.

        NaN where there are no closed forms.
        """
        shape = self.scene.body.shape
        if not isinstance(shape, Spheroid):
            return float("nan")
        k = shape.aspect_ratio
        exact = np.array([*stress.stresslet_numbers(k), stress.held_number(k)])
        return float(np.max(np.abs(np.array(list(self._numbers.values())) / exact - 1.0)))

    def _sizes(self) -> tuple[float, float, float, float]:
        """Velocity, angular velocity, force and torque of a body that moves as fast as the flow."""
        scene, shape = self.scene, self.scene.body.shape
        theta = np.linspace(0.0, np.pi, 9)[:, None]
        surface = shape.surface(theta, theta.T * 2.0).reshape(-1, 3)
        turn = rotation.matrix(scene.quaternion[0])
        speed = np.linalg.norm(scene.flow.velocity(scene.position[0] + surface @ turn.T), axis=-1)
        fast, length = float(speed.max()), shape.radius
        r = self.formed.model.resistance
        force, torque = r.translation_transverse * fast, r.rotation_transverse * fast / length
        return fast, fast / length, force, torque
