"""Sections of the scene: body, flow, start, forces, constraints."""

from typing import Annotated, Any, Literal

from qbxstokes.case.model import (
    VECTOR,
    Angle,
    Direction,
    NotNegative,
    Positive,
    Reader,
    Section,
    Vector,
    key,
    number,
    pointing,
    several,
)
from qbxstokes.case.values import (
    Problem,
    describe,
    increasing,
    meant,
    or_infinite,
    to_number,
    with_numbers,
)
from qbxstokes.errors import SceneError
from qbxstokes.expressions import FUNCTIONS, expression_in_time
from qbxstokes.geometry.registry import SHAPES, build_shape

FREE, LOCKED, WITH_FLOW = "free", "locked", "with_flow"


class ShapeSection(Section, is_open=True):
    """The shape of a body: `type`, and the numbers of that type."""

    type: str = key("name of the shape; its own keys follow in this section", example="spheroid")

    @classmethod
    def _prepare(cls, data: Any) -> Any:
        if isinstance(data, str):
            right = f"write shape: {{type: {data}}} and its numbers; types: {', '.join(SHAPES)}"
            raise Problem(f"is {describe(data)}", right)
        if isinstance(data, dict) and (name := data.get("type", "spheroid")) not in list(SHAPES):
            known = meant(str(name), SHAPES, f"known here: {', '.join(SHAPES)}")
            raise Problem(f"is {describe(name)}", known, ("type",))
        if not isinstance(data, dict):
            return data
        return {n: v if n == "type" else to_number(v) for n, v in data.items()}


_RATIO = number(gt=0, le=1e6, ge=1e-6)


class Body(
    Section,
    k=("is called aspect_ratio", "write aspect_ratio: 0.5"),
    St=("is called stokes_number", "write stokes_number: 10"),
    density=("is no key of a body", "stokes_number says how heavy it is (`help units`)"),
):
    """The body: its shape, given in one of three ways, and how heavy it is."""

    aspect_ratio: Annotated[float, _RATIO] | None = key(
        "of a spheroid, k = a/c, equatorial over polar radius: prolate < 1, sphere 1, oblate > 1",
        None,
        0.5,
    )
    length_over_diameter: Annotated[float, _RATIO] | None = key(
        "of a spheroid, 1/k, in the place of aspect_ratio", None, 2.0
    )
    shape: ShapeSection | None = key("any shape, by its type and numbers", None)
    stokes_number: NotNegative = key(
        "St, particle inertia over viscous force; 0 is a massless body", 0.0, 10.0
    )
    inertia: Literal["both", "translation", "rotation"] = key(
        "inertia of both motions, or of one alone: the other then follows the flow", "both"
    )

    @property
    def outline(self) -> Any:
        """The shape as an object."""
        shape = None if self.shape is None else {"type": self.shape.type, **self.shape.extra}
        return build_shape(self.aspect_ratio, self.length_over_diameter, shape)

    def _check(self) -> None:
        ways = ("aspect_ratio", "length_over_diameter", "shape")
        given = [name for name in ways if getattr(self, name) is not None]
        if not given:
            meaning = self.declared["aspect_ratio"].meaning
            right = f"{meaning}; for example aspect_ratio: 0.5"
            raise Problem("is missing", right, ("aspect_ratio",))
        if len(given) > 1:
            raise Problem(f"gives {' and '.join(given)}", "exactly one of them says the shape")
        try:
            self.outline  # noqa: B018
        except SceneError as error:
            raise Problem(error.wrong, error.right, tuple(error.key.split("."))) from None


class FlowSection(Section, is_open=True):
    """The background flow: `type`, and the keys of that type."""

    type: str = key("name of the flow; its own keys follow in this section", example="shear")

    @classmethod
    def _prepare(cls, data: Any) -> Any:
        if isinstance(data, str):
            name = data.removeprefix("<python>.py:")
            right = f"type: user, function: {name}" if ".py:" in data else f"type: {data}"
            raise Problem(f"is {describe(data)}", f"write flow: {{{right}}}")
        if not isinstance(data, dict):
            return data
        return {n: v if n == "type" else with_numbers(v) for n, v in data.items()}

    def spec(self) -> dict[str, Any]:
        """The plain dictionary from which the flow is built."""
        return {"type": self.type, **self.extra}


class EulerAngles(Section):
    """Orientation R = R3(phi) R1(theta) R3(psi)."""

    phi: Angle = key("phi, radians or '90 deg'", 0.0, 0.0)
    theta: Angle = key("theta, angle from e3 to D3, radians or '90 deg'", 0.0, 1.2)
    psi: Angle = key("psi, radians or '90 deg'", 0.0, 0.0)


class Orbit(Section):
    """Axis on a Jeffery orbit of the shear u = (x2, 0, 0).

    D3 is along (C cos(phase), -C k sin(phase), 1); the phase of a massless body grows steadily by
    360 deg a period, and phase 0 is an axis in the plane of x1 and x3.
    """

    constant: Annotated[float, number(or_infinite, ge=0)] = key(
        "orbit constant C = tan(theta) at phase 0: 0 is log-rolling, inf tumbling", example=1.0
    )
    phase: Angle = key("phase, radians or '90 deg'", 0.0, 0.0)


class Orientation(Section):
    """Orientation in exactly one of four forms."""

    quaternion: (
        Annotated[tuple[float, ...], pointing(several(number(), "[q0, q1, q2, q3]"))] | None
    ) = key("[q0, q1, q2, q3], scalar first, body to space; normalised", None, [1.0, 0.0, 0.0, 0.0])
    euler: EulerAngles | None = key("Euler angles phi, theta, psi", None)
    axis: Direction | None = key(
        "direction of the symmetry axis D3 in space; normalised", None, [0.0, 0.6, 0.8]
    )
    orbit: Orbit | None = key("Jeffery orbit of a shear (x2, 0, 0): constant and phase", None)

    @classmethod
    def _prepare(cls, data: Any) -> Any:
        if isinstance(data, list) and len(data) in (3, 4):
            form = "axis" if len(data) == 3 else "quaternion"
            raise Problem(f"is {describe(data)}", f"write orientation: {{{form}: [...]}}")
        return data

    def _check(self) -> None:
        given = [name for name in self.declared if getattr(self, name) is not None]
        if len(given) != 1:
            wrong = f"gives {' and '.join(given)}" if given else "gives no orientation"
            raise Problem(wrong, "give exactly one of quaternion, euler, axis, orbit")


_MOVING = several(number(), "[v1, v2, v3]")


def _velocity(value: Any) -> Any:
    if value == WITH_FLOW or isinstance(value, (list, tuple)):
        return value if value == WITH_FLOW else _MOVING.read(value)
    raise Problem(f"is {describe(value)}", "write with_flow or three numbers [v1, v2, v3]")


VELOCITY = Reader(_velocity, {"anyOf": [{"enum": [WITH_FLOW]}, _MOVING.json]})


def _form(name: str, value: str) -> tuple[str, str]:
    return "is a form of orientation", f"write orientation: {{{name}: {value}}}"


class Start(
    Section,
    axis=_form("axis", "[1, 0, 0]"),
    euler=_form("euler", "{theta: 90 deg}"),
    quaternion=_form("quaternion", "[1, 0, 0, 0]"),
    orbit=_form("orbit", "{constant: 1}"),
):
    """Position, orientation and velocities at time 0."""

    position: Vector = key("centre of the body, in lengths c", (0.0, 0.0, 0.0), [0.0, 0.0, 0.0])
    orientation: Orientation = key(
        "orientation as quaternion, euler, axis or orbit", Orientation(axis=(0.0, 0.0, 1.0))
    )
    velocity: Annotated[Any, VELOCITY] = key(
        "[v1, v2, v3] in space, or with_flow: force-free (needs stokes_number > 0)", WITH_FLOW
    )
    angular_velocity: Annotated[Any, VELOCITY] = key(
        "[w1, w2, w3] in space, or with_flow: torque-free (needs stokes_number > 0)", WITH_FLOW
    )


class Gravity(Section):
    """Weight less buoyancy, Theta G e, with the volume Theta = 4 pi k^2/3 and a direction e.

    G = (rho_p - rho_f) g c tau/mu is given as `number`, or follows from the particle's Stokes
    number St = rho_p c^2/(mu tau), `acceleration` = g tau^2/c and `density_ratio` = rho_p/rho_f:
    G = St acceleration (1 - 1/density_ratio).
    """

    direction: Direction = key("direction of gravity in space; normalised", (0.0, 0.0, -1.0))
    number: float | None = key(
        "G = (rho_p - rho_f) g c tau/mu, net weight per volume; may be negative", None, 1.0
    )
    acceleration: NotNegative | None = key(
        "g tau^2/c, with density_ratio in place of number (stokes_number > 0)", None, 1.0
    )
    density_ratio: Positive | None = key("rho_p/rho_f, of body to fluid", None, 2.5)

    def _check(self) -> None:
        pair = (self.acceleration, self.density_ratio)
        if (self.number is None) == (pair == (None, None)):
            raise Problem("is not determined", "give number, or acceleration and density_ratio")
        if self.number is None and None in pair:
            missing = "acceleration" if pair[0] is None else "density_ratio"
            raise Problem("is missing", "acceleration and density_ratio go together", (missing,))

    def net(self, stokes_number: float) -> float:
        """G, the net weight per volume."""
        if self.number is not None:
            return self.number
        assert self.acceleration is not None
        assert self.density_ratio is not None
        return stokes_number * self.acceleration * (1.0 - 1.0 / self.density_ratio)


_EXAMPLE = "[1, 0, 'sin(2*pi*t)']"


def _component(value: Any) -> float | str:
    """A number, or the text of an expression in t that can be evaluated."""
    try:
        return to_number(value)
    except Problem:
        if not isinstance(value, str):
            raise
    try:
        float(expression_in_time(value)(0.0))
    except (ValueError, TypeError, ArithmeticError) as error:
        right = f"a number, or an expression in t of {', '.join(FUNCTIONS)}, pi"
        raise Problem(f"{describe(value)}: {error}", right) from None
    return value


def timed_entry(value: Any) -> Any:
    """A vector that may depend on time, as plain data."""
    if isinstance(value, (list, tuple)):
        if len(value) != 3:
            raise Problem(f"has {len(value)} entries", f"3 numbers are expected: {_EXAMPLE}")
        return tuple(_component(entry) for entry in value)
    if isinstance(value, str) and value.rpartition(":")[0].endswith(".py"):
        return value
    if isinstance(value, dict):
        return _table(value)
    right = f"three entries such as {_EXAMPLE}, a table, or file.py:function"
    raise Problem(f"is {describe(value)}", right)


def _table(value: dict[str, Any]) -> dict[str, Any]:
    if set(value) == {"table"} and isinstance(value["table"], str):
        return value
    if set(value) != {"times", "values"} or not all(isinstance(v, list) for v in value.values()):
        right = "{table: file.csv} of t, 1, 2, 3, or {times: [t0, ...], values: [[1, 2, 3], ...]}"
        raise Problem("is neither of the tables", right)
    instants = several(number()).read(value["times"])
    increasing(instants, "times")
    if len(instants) < 2 or len(instants) != len(value["values"]):
        raise Problem("has too few rows", "two rows or more, one per instant", ("times",))
    return {"times": instants, "values": several(VECTOR).read(value["values"])}


TIMED = Reader(timed_entry, {"anyOf": [VECTOR.json, {"type": "string"}, {"type": "object"}]})
TimedVector = Annotated[Any, TIMED]


class Forces(Section):
    """External force (mu c^2/tau) and torque (mu c^3/tau); all that are given add up."""

    force: TimedVector | None = key(
        "in space: 3 numbers or expressions in t, a table, or file.py:function",
        None,
        [0.0, 0.0, -1.0],
    )
    torque: TimedVector | None = key("in space, about the centre", None, [0.0, 0.0, "sin(2*pi*t)"])
    body_force: TimedVector | None = key("fixed in the body, D3 last", None, [0.0, 0.0, 1.0])
    body_torque: TimedVector | None = key("fixed in the body, D3 last", None, [0.0, 0.0, 1.0])
    gravity: Gravity | None = key("weight less buoyancy", None)

    @property
    def given(self) -> bool:
        """Whether there is any."""
        return any(getattr(self, name) is not None for name in self.declared)


BOUND = Reader(lambda value: value if value in (FREE, LOCKED) else timed_entry(value), TIMED.json)


class Constraints(Section):
    """Translation and rotation: free, locked, or prescribed; force and torque are recorded."""

    translation: Annotated[Any, BOUND] = key(
        "free, locked, or velocity in space: numbers, expressions in t, ...", FREE, LOCKED
    )
    rotation: Annotated[Any, BOUND] = key(
        "free, locked, or angular velocity in space: as above", FREE, [0.0, 0.0, "cos(t)"]
    )

    @property
    def given(self) -> bool:
        """Whether there is any."""
        return self.translation != FREE or self.rotation != FREE
