"""The one list of what can be recorded: every quantity with its symbol, units, frame and shape.

Result files, pictures, exports, summaries, the schema of a case and the pages read it;
`motion.observables` computes those of a motion. Everything is nondimensional: length c (polar
radius), time tau, force mu c^2/tau, torque mu c^3/tau. Symbols are LaTeX.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_XYZ = ("1", "2", "3")
_QUATERNION = ("0", *_XYZ)
_ANGLES = ("phi", "theta", "psi")
_PAIRS = ("11", "22", "33", "12", "13", "23")


@dataclass(frozen=True)
class Quantity:
    """What is known of a quantity before it has a value.

    shape: at one instant, at one point, or of one trajectory. components: what tells them apart in
    names such as position_1. parts: symbols of the components, where they are not the symbol with
    the component below. label: what stands at an axis, where it is not the name and the symbol.
    """

    name: str
    symbol: str
    units: str
    description: str
    frame: str = ""
    shape: tuple[int, ...] = ()
    components: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()
    label: str = ""

    @property
    def size(self) -> int:
        """How many numbers it is."""
        return math.prod(self.shape)

    @property
    def symbols(self) -> tuple[str, ...]:
        """The symbol of each component."""
        return self.parts or tuple(f"{self.symbol}_{part}" for part in self.components)

    @property
    def heading(self) -> str:
        """Words and symbol, for the axis of a picture."""
        return self.label or self._headed(self.symbol)

    def _headed(self, symbol: str) -> str:
        words = self.name.replace("_", " ")
        return f"{words} ${symbol}$" if symbol else words

    def columns(self) -> list[Quantity]:
        """Its components as a quantity each, position_1 and so on; itself where it has none."""
        return [
            Quantity(
                f"{self.name}_{part}",
                symbol,
                self.units,
                self.description,
                self.frame,
                label=self._headed(symbol),
            )
            for part, symbol in zip(self.components, self.symbols, strict=True)
        ] or [self]


def _vector(name: str, symbol: str, units: str, description: str, frame: str = "space") -> Quantity:
    return Quantity(name, symbol, units, description, frame, (3,), _XYZ)


def _quaternion(name: str, description: str) -> Quantity:
    return Quantity(name, "q", "1", description, "body to space", (4,), _QUATERNION)


def _mean(name: str, symbol: str, units: str, description: str) -> Quantity:
    parts = tuple(rf"\langle {symbol}_{i}\rangle" for i in _XYZ)
    whole = rf"\langle {symbol}\rangle"
    return Quantity(name, whole, units, description, "space", (3,), _XYZ, parts)


def _named(*quantities: Quantity) -> dict[str, Quantity]:
    return {quantity.name: quantity for quantity in quantities}


TIME = Quantity("time", "t", "tau", "instants of the samples")
INSTANT = Quantity("time", "t", "tau", "instants of the field")
TRAJECTORY = Quantity("trajectory", "", "1", "number of the trajectory")
SAMPLE = Quantity("sample", "", "1", "number of the sample")

# Of a motion, at every sample.
MOTION = _named(
    _vector("position", "x", "c", "centre of the body"),
    _quaternion("orientation", "unit quaternion, scalar first"),
    _vector("axis", "D^3", "1", "symmetry axis D3"),
    _vector("velocity", "V", "c/tau", "velocity of the centre"),
    _vector("angular_velocity", r"\Omega", "1/tau", "angular velocity"),
    _vector("force", "F", "mu c^2/tau", "hydrodynamic force on the body"),
    _vector("torque", "M", "mu c^3/tau", "hydrodynamic torque on the body"),
    Quantity(
        "euler_angles",
        r"\mathrm{angle}",
        "rad",
        "phi, theta, psi of R3 R1 R3",
        "body to space",
        (3,),
        _ANGLES,
        (r"\varphi", r"\theta", r"\psi"),
    ),
    Quantity(
        "orbit_constant",
        "C",
        "1",
        "Jeffery's orbit constant in the shear at the start: infinite when tumbling",
    ),
)

# Of an event, in the order in which they are recorded; half-turns have some more.
EVENT = _named(
    Quantity("time", "t", "tau", "instant of the event"),
    MOTION["position"],
    MOTION["axis"],
    MOTION["velocity"],
    Quantity("orbit_constant", "C", "1", "orbit constant in the shear at the start of the motion"),
)
HALF_TURN = EVENT | _named(
    Quantity("period", "T", "tau", "time since the last half-turn but one"),
    _vector("drift", r"\Delta x", "c", "displacement since the last half-turn but one"),
)


def of_event(name: str) -> dict[str, Quantity]:
    """What is recorded of the events of one name."""
    return HALF_TURN if name == "half_turns" else EVENT


# Of the flow around a body: what may be asked for, what every point has, what its surface has.
FLUID = _named(
    _vector("velocity", "u", "c/tau", "velocity of the fluid"),
    _vector("disturbance_velocity", "u'", "c/tau", "velocity minus that of the background flow"),
    Quantity("pressure", "p", "mu/tau", "pressure, with that of the background flow"),
    Quantity(
        "stress",
        r"\sigma",
        "mu/tau",
        "stress tensor",
        "space",
        (6,),
        _PAIRS,
        tuple(rf"\sigma_{{{pair}}}" for pair in _PAIRS),
    ),
)
POINT = _named(
    _vector("points", "x", "c", "points"),
    Quantity("inside", "", "1", "point in the body"),
    Quantity("source", "", "1", "0 plain, 1 graded quadrature, 2 QBX, 3 table; -1 in the body"),
)
SURFACE = _named(
    _vector("traction", "f", "mu/tau", "force of the fluid on the body per area"),
    _vector("normals", "n", "1", "outward unit normals"),
)

# Of a whole trajectory: what the table of a sweep says after the swept values.
SUMMARY = _named(
    Quantity("period", "T", "tau", "twice the mean time of a half-turn of the axis"),
    Quantity(
        "period_change",
        r"\Delta T/T",
        "1",
        "period over the later half of the half-turns minus earlier, relative",
    ),
    Quantity("half_turns", "", "1", "whole half-turns of the axis that averages are taken over"),
    Quantity(
        "rotation_rate",
        r"\langle\Omega\rangle",
        "1/tau",
        "mean rate of the axis about the vorticity's direction",
        label=r"mean rotation rate $\langle\Omega\rangle$",
    ),
    _mean("mean_velocity", "V", "c/tau", "mean velocity over whole half-turns"),
    _mean(
        "velocity_change",
        r"\Delta V",
        "c/tau",
        "mean velocity over the later half-turns minus the earlier",
    ),
    Quantity(
        "orbit_constant_start",
        "C",
        "1",
        "orbit constant in the local shear at the first sample",
        label="orbit constant $C$ at the start",
    ),
    Quantity(
        "orbit_constant_end",
        "C",
        "1",
        "orbit constant in the local shear at the last sample",
        label="orbit constant $C$ at the end",
    ),
    Quantity(
        "orbit_drift",
        r"\mathrm{d}\ln C/\mathrm{d}t",
        "1/tau",
        "mean rate of the logarithm of the orbit constant",
    ),
    Quantity(
        "jeffery_period",
        "T",
        "tau",
        "Jeffery's period in the gradient at the start",
        label="Jeffery's period $T$",
    ),
    Quantity("end", "t", "tau", "last instant", label="last instant $t$"),
    _vector("final_position", "x", "c", "position at the end"),
    _quaternion("final_orientation", "orientation quaternion at the end"),
    _vector("final_velocity", "V", "c/tau", "velocity at the end"),
    _vector("final_angular_velocity", r"\Omega", "1/tau", "angular velocity at the end, in space"),
    Quantity("steps", "", "1", "steps of its block"),
    Quantity(
        "rhs_evaluations",
        "",
        "1",
        "right-hand sides of its block, each for every trajectory in it",
        label="right-hand sides",
    ),
    Quantity(
        "error_estimate",
        "",
        "1",
        "error accepted in the integration, and the body model's over time",
    ),
    Quantity("wall_time", "", "s", "wall time of its block over the number of trajectories in it"),
)
# The same with one number per name, as the table has it.
COLUMNS = _named(*(column for quantity in SUMMARY.values() for column in quantity.columns()))

# Of a body without a motion: its law, in a flow what it does there, and what forming it took.
BODY = _named(
    Quantity(
        "resistance",
        "R",
        "mu c, mu c^3",
        "force and torque on the body are -R (velocity, angular velocity)",
        "body",
        (6, 6),
    ),
    Quantity(
        "mobility",
        "M",
        "1/(mu c), 1/(mu c^3)",
        "(velocity, angular velocity) are M (force, torque) from outside",
        "body",
        (6, 6),
    ),
    Quantity("linear", r"\lambda", "1", "Omega = w/2 + linear D3 x (E D3) in a linear flow"),
    Quantity(
        "quadratic",
        "q",
        "c^2",
        "coefficients of the free velocity's second derivatives of the flow",
        "",
        (5,),
        ("0", "1", "2", "3", "4"),
    ),
    Quantity(
        "cubic",
        "c",
        "c^2",
        "coefficients of the free angular velocity's third derivatives of the flow",
        "",
        (4,),
        ("0", "1", "2", "3"),
    ),
    _vector("free_velocity", "U", "c/tau", "velocity of the free body"),
    _vector("free_angular_velocity", r"\Omega", "1/tau", "angular velocity of the free body"),
    _vector("held_force", "F", "mu c^2/tau", "force on the body held fixed"),
    _vector("held_torque", "M", "mu c^3/tau", "torque on the body held fixed"),
)
_RESISTANCE = (
    *(("translation", direction, "mu c") for direction in ("transverse", "axial")),
    *(("rotation", direction, "mu c^3") for direction in ("transverse", "axial")),
)
_SETUP_TIME = Quantity(
    "setup_time", "", "s", "time to form the body: the median where measured", label="set-up time"
)
_ITERATIONS = Quantity("iterations", "", "1", "GMRES iterations of all solves")
_ERROR = Quantity("error", "", "1", "largest error against closed forms and references")
# Of a measured trajectory, besides and in the place of the other columns.
MEASURED = _named(
    Quantity("wall_time", "", "s", "wall time of the motion, without set-up: the median"),
    _SETUP_TIME,
    Quantity("rejected", "", "1", "rejected steps"),
    _ITERATIONS,
    _ERROR,
)
BODY_COLUMNS = _named(
    *(
        Quantity(
            f"resistance_{motion}_{direction}",
            rf"R^{{\mathrm{{{motion[0]}}}}}_{{{'1' if direction == 'transverse' else '3'}}}",
            units,
            f"resistance to {motion}, {direction}",
            label=f"resistance to {motion}, {direction}",
        )
        for motion, direction, units in _RESISTANCE
    ),
    *(
        column
        for quantity in BODY.values()
        if len(quantity.shape) < 2
        for column in quantity.columns()
    ),
    Quantity("error_estimate", "", "1", "estimated error of resistance and free motion, relative"),
    _ERROR,
    _ITERATIONS,
    Quantity("true_residual", "", "1", "largest true residual of the solves, relative"),
    _SETUP_TIME,
    Quantity("n_theta", r"n_\vartheta", "1", "nodes along a meridian", label=r"$n_\vartheta$"),
    Quantity("n_phi", r"n_\phi", "1", "nodes around the axis", label=r"$n_\phi$"),
    Quantity("expansion_order", "p", "1", "order of the expansions"),
    Quantity("nodes", "", "1", "nodes on the surface"),
)

STATUS = _named(
    Quantity("status", "", "", "0 missing, 1 done, 2 failed"),
    Quantity("reason", "", "", "why it failed"),
)

# Of a case: keys that have a symbol, by their names in the table of a sweep.
PARAMETER = _named(
    Quantity("aspect_ratio", "k", "1", "k = a/c, equatorial over polar radius"),
    Quantity(
        "stokes_number",
        r"\mathrm{St}",
        "1",
        "St, particle inertia over viscous force",
        label=r"Stokes number $\mathrm{St}$",
    ),
    *(
        Quantity(
            f"start_euler_{angle}",
            f"{symbol}_0",
            "rad",
            f"{angle} at the start",
            label=f"${symbol}$ at the start",
        )
        for angle, symbol in zip(_ANGLES, MOTION["euler_angles"].parts, strict=True)
    ),
    Quantity("upsampling", r"\kappa", "1", "factor of the finer grid"),
)


_COLUMN = MEASURED | BODY_COLUMNS | COLUMNS | PARAMETER


def column(name: str) -> Quantity:
    """What a column of the table of a sweep is; one that is not listed is its name alone."""
    return _COLUMN.get(name.removeprefix("hydrodynamics_")) or Quantity(name, "", "", "")
