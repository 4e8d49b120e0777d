"""Simulations: bodies, flow, surroundings, loads, constraints, events and their integration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.bie.rigid import Completion
from qbxstokes.case.document import written
from qbxstokes.case.running import Brownian
from qbxstokes.case.running import Events as EventSettings
from qbxstokes.errors import FlowError, SceneError
from qbxstokes.flows import Flow
from qbxstokes.flows.check import PASSED, check_regular, check_singularities, check_stokesian
from qbxstokes.flows.domain import outside
from qbxstokes.flows.recognition import Recognition, recognised
from qbxstokes.geometry import rotation
from qbxstokes.motion.averages import ShearFrame
from qbxstokes.motion.diagnostics import jeffery_period
from qbxstokes.motion.equations import Constraints, Loads
from qbxstokes.simulation.arguments import (
    accepted,
    numbers,
    require,
    require_flow,
    section,
    turned,
)
from qbxstokes.simulation.assembly import Assembled, assemble
from qbxstokes.simulation.lanes import check_brownian
from qbxstokes.simulation.result import Motion
from qbxstokes.typing import Array, Indices

if TYPE_CHECKING:
    from qbxstokes.simulation.body import Body

_COUPLED = "qbxstokes.simulation.coupled"
ORIGIN, UPRIGHT = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)


class Simulation:
    """One scene: a body in a flow, where it starts, and what acts on it.

    bodies: one `Body`; a list of several in one fluid, or a `Wall` as surroundings, make it a
    `CoupledSimulation`, without lanes. flow: a background flow (`qs.flow`). position (..., 3),
    orientation: axes (..., 3) or quaternions (..., 4), and the body's stokes_number (...)
    broadcast; their leading axes are lanes, independent copies that are integrated together.
    velocity, angular_velocity (..., 3): at the start, space frame; None: with the flow. loads:
    external force and torque. constraints: held or prescribed parts of the motion. events: keys of
    that section of a case. brownian: likewise, such as {"rotary_diffusivity": 0.1}; lanes are
    independent then. tolerance: error accepted at the end of the motion. On several ranks
    every rank builds the same simulation.

    >>> import numpy as np, qbxstokes as qs
    >>> axes = [[1, 0, 1], [1, 0, 2]]
    >>> scene = qs.Simulation(qs.Body(0.5), qs.flow("shear"), orientation=axes)
    >>> motion = scene.integrate(np.linspace(0.0, scene.period, 41))
    >>> motion.axis.shape, bool(np.allclose(motion.axis[:, -1], motion.axis[:, 0]))
    ((2, 41, 3), True)
    """

    # Whether bodies share the fluid or feel a wall, and whether they were given as a list.
    coupled = several = False
    brownian: Brownian | None = None
    numbers: NDArray[np.uint64]  # of the lanes as trajectories, which choose their random numbers

    def __new__(
        cls, bodies: Any = None, flow: Any = None, surroundings: Any = None, **_: Any
    ) -> Any:
        """Several bodies, or one by a wall, make a `CoupledSimulation`; a copy stays what it is."""
        if cls is Simulation and (isinstance(bodies, Sequence) or surroundings is not None):
            # It stands on this class, and is looked up when it is needed.
            return super().__new__(import_module(_COUPLED).CoupledSimulation)
        return super().__new__(cls)

    def __init__(
        self,
        bodies: Body | Sequence[Body],
        flow: Flow,
        surroundings: Any = None,
        *,
        position: ArrayLike = ORIGIN,
        orientation: ArrayLike = UPRIGHT,
        velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        loads: Loads | None = None,
        constraints: Constraints | None = None,
        events: Mapping[str, Any] | EventSettings | None = None,
        brownian: Mapping[str, Any] | Brownian | None = None,
        tolerance: float = 1e-10,
    ) -> None:
        assert not isinstance(bodies, Sequence)  # `__new__` has made it another class
        bodies.check_size()
        require_flow(flow)
        require("loads", loads, Loads, "qs.Loads(force=[0, 0, -1])")
        require("constraints", constraints, Constraints, "qs.Constraints(velocity=[0, 0, 0])")
        self.body, self.flow = bodies, flow
        x, q, lead = places(position, orientation)
        self.lanes = np.broadcast_shapes(lead, self.body.stokes_number.shape)
        self.position = self._per_lane("position", x.reshape(*lead, 3), 3)
        self.quaternion = self._per_lane("orientation", q.reshape(*lead, 4), 4)
        stokes = np.broadcast_to(self.body.stokes_number, self.lanes).reshape(-1)
        self.stokes_number: Array = np.array(stokes)
        self.velocity = self._optional("velocity", velocity)
        self.angular_velocity = self._optional("angular_velocity", angular_velocity)
        self.loads, self.constraints = loads, constraints
        self.events = section("events", EventSettings, events)
        self.tolerance = accepted(tolerance)
        self.numbers = np.arange(len(self.position), dtype=np.uint64)
        if brownian is not None:
            self.brownian = section("brownian", Brownian, brownian)
            check_brownian(self)

    def _per_lane(self, name: str, values: Array, width: int) -> Array:
        try:
            whole = np.broadcast_to(values, (*self.lanes, width))
        except ValueError:
            raise SceneError(
                name, f"has shape {values.shape}", f"shape {(*self.lanes, width)}, one per lane"
            ) from None
        return np.array(whole, dtype=np.float64).reshape(-1, width)

    def _optional(self, name: str, values: ArrayLike | None) -> Array | None:
        if values is None:
            return None
        vectors = numbers(name, values, "three numbers, or (..., 3)")
        if vectors.shape[-1:] != (3,):
            raise SceneError(name, f"has shape {vectors.shape}", "three numbers, or (..., 3)")
        return self._per_lane(name, vectors, 3)

    def __len__(self) -> int:
        """Number of lanes, or of bodies that share a fluid."""
        return len(self.position)

    def at(self, chosen: Indices) -> Simulation:
        """Some of the lanes, by their numbers, as one row of lanes."""

        def rows(vectors: Any) -> Any:
            whole = vectors is None or callable(vectors) or np.ndim(vectors) < 2
            return vectors if whole else vectors[chosen]

        some, stokes = copy(self), self.stokes_number[chosen]
        for known in ("gradient", "frame", "period", "recognised"):
            vars(some).pop(known, None)
        some.body, some.lanes = self.body.with_inertia(stokes, self.body.inertia), (len(chosen),)
        some.stokes_number, some.numbers = stokes, self.numbers[chosen]
        some.position = self.position[chosen]
        some.quaternion = rotation.normalize(self.quaternion[chosen])
        some.velocity, some.angular_velocity = map(rows, (self.velocity, self.angular_velocity))
        if self.loads is not None:
            some.loads = Loads(*map(rows, vars(self.loads).values()))
        if self.constraints is not None:
            some.constraints = Constraints(*map(rows, vars(self.constraints).values()))
        return some

    def shaped(self, values: Array) -> Array:
        """Values (n, ...) of the lanes in the shape of the leading axes."""
        return values.reshape((*self.lanes, *values.shape[1:]))

    # -- what the scene is --------------------------------------------------------------------

    @cached_property
    def gradient(self) -> Array:
        """Velocity gradient (3, 3) at the first lane's start."""
        return np.asarray(self.flow.gradient(self.position[0]))

    @cached_property
    def frame(self) -> ShearFrame:
        """Directions of stream, gradient and vorticity at the first lane's start."""
        return ShearFrame.of(self.gradient)

    @cached_property
    def period(self) -> float | None:
        """Jeffery's period in the gradient at the start; None where the axis comes to rest."""
        return jeffery_period(self.gradient, self.body.effective_ratio)

    @property
    def massless(self) -> bool:
        """Whether no lane has inertia."""
        return not np.any(self.stokes_number)

    @property
    def pushed(self) -> bool:
        """Whether force and torque enter the motion, or come of it."""
        return not self.massless or self.loads is not None or self.constraints is not None

    @property
    def kind(self) -> str:
        """How the free motion is found: by "table", on the "grid", or solved at "every_step"."""
        if self.body.settings.solve == "every_step":
            return "every_step"
        degree = self.carrier.degree
        return "table" if degree is not None and degree <= 3 else "grid"

    @cached_property
    def recognised(self) -> Recognition | None:
        """What a function of the user's is found to be, where that is a polynomial."""
        flow, settings = self.flow, self.body.settings
        function = flow.degree is None and not flow.singular_points_known and flow.recognise
        if not function or settings.derivatives or settings.solve == "every_step":
            return None
        return recognised(flow)

    @property
    def carrier(self) -> Any:
        """The flow that moves the body: the polynomial that a function was found to be."""
        return self.flow if self.recognised is None else self.recognised.flow

    def completion(self, pushed: bool = False) -> Completion | None:
        """That of the resistance problem; None where the resistance is not needed.

        pushed: with the resistance in any case.
        """
        asked = self.body.settings.completion
        needed = pushed or self.pushed or self.brownian is not None
        return "surface" if asked is None and needed else asked

    def check(self) -> None:
        """Refuse a flow that is not Stokesian near the body, singular in it, or that ends there."""
        flow, shape = self.flow, self.body.shape
        if self.body.settings.derivatives and self.kind != "grid":
            wrong = f"has no meaning where the free motion is found by {self.kind}"
            raise SceneError("hydrodynamics.derivatives", wrong, "leave it out")
        axes = rotation.axis(self.quaternion)
        beyond = outside(flow.domain, self.position, axes, shape)
        if beyond:
            raise SceneError(
                "start.position", next(iter(beyond.values())), "start with the whole body inside"
            )
        try:
            if len(flow.singular_points):
                for place, axis in zip(self.position, axes, strict=True):
                    check_singularities(flow, place, axis, shape)
        except FlowError as error:
            right = "move the body or the singular point"
            raise SceneError("start.position", str(error), right) from None
        try:
            degree = self.body.settings.derivatives
            local = degree is not None
            if flow not in PASSED:
                check_stokesian(flow, self.position[0], radius=2.0 * shape.radius, local=local)
            if degree is not None:
                flow.expansion(self.position[:1], 0.0, degree)
        except FlowError as error:
            raise SceneError(".".join(map(str, ("flow", *error.key))), str(error)) from None
        if flow.singular_points_known:
            return
        try:
            check_regular(flow, self.position[0], axes[0], shape)
        except FlowError as error:
            raise SceneError("flow", str(error), "a start.position away from there") from None

    # -- what is done with it -----------------------------------------------------------------

    def assemble(self, *, t: float = 0.0) -> Assembled:
        """The equations of the scene with their start at time t, hydrodynamics formed."""
        self.check()
        return assemble([self], t=t)

    def integrate(self, times: ArrayLike) -> Motion:
        """The motion from t = 0, sampled at increasing times (T,), by PETSc TS.

        Raises ConvergenceError where a step cannot be completed.
        """
        return self.assemble().integrate(times)

    def to_yaml(self, times: ArrayLike | None = None) -> str:
        """The text of a case that says the same; lanes become an axis of a sweep.

        times: instants to store. Raises SceneError naming what no file holds, such as a function.
        """
        from qbxstokes.simulation.writing import to_case

        return written(to_case(self, times))

    @staticmethod
    def stack(simulations: Sequence[Simulation]) -> Assembled:
        """Several simulations, which may differ in body and flow, as the lanes of one to integrate.

        Their tolerance, constraints and kind of inertia have to agree, and their flows have to be
        polynomials (degree <= 3) or the same.
        """
        for simulation in simulations:
            simulation.check()
        return assemble(simulations)


def places(position: ArrayLike, orientation: ArrayLike) -> tuple[Array, Array, tuple[int, ...]]:
    """Positions (n, 3), unit quaternions (n, 4), and the shape of the leading axes of both."""
    x = numbers("position", position, "three numbers [x1, x2, x3], or places (..., 3)")
    turn = turned(orientation)
    if x.shape[-1:] != (3,) or turn.shape[-1:] not in ((3,), (4,)):
        raise SceneError(
            "position",
            f"has shape {x.shape} and orientation {turn.shape}",
            "they end in 3, and in 3 (axis) or 4 (quaternion)",
        )
    q = rotation.normalize(turn) if turn.shape[-1] == 4 else rotation.from_axis(turn)
    try:
        lead = np.broadcast_shapes(x.shape[:-1], q.shape[:-1])
    except ValueError:
        wrong = f"has shape {x.shape} and orientation {turn.shape}"
        raise SceneError("position", wrong, "leading axes that broadcast") from None
    return (
        np.array(np.broadcast_to(x, (*lead, 3))).reshape(-1, 3),
        np.array(np.broadcast_to(q, (*lead, 4))).reshape(-1, 4),
        lead,
    )
