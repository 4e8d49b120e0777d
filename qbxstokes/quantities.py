"""The one list of what can be recorded: every quantity with its symbol, units, frame and shape.

Result files, pictures, exports, summaries, the schema of a case and the pages read it;
`motion.observables` computes those of a motion. Everything is nondimensional: length c (polar
radius), time tau, force mu c^2/tau, torque mu c^3/tau. Symbols are LaTeX.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

_XYZ = ("1", "2", "3")
_ANGLES, _ANGLE_SYMBOLS = ("phi", "theta", "psi"), (r"\varphi", r"\theta", r"\psi")
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
        form = "{}_{}" if all(len(part) == 1 for part in self.components) else "{}_{{{}}}"
        return self.parts or tuple(form.format(self.symbol, part) for part in self.components)

    @property
    def heading(self) -> str:
        """Words and symbol, for the axis of a picture."""
        return self.label or self._headed(self.symbol)

    def _headed(self, symbol: str) -> str:
        words = self.name.replace("_", " ")
        return f"{words} ${symbol}$" if symbol else words

    def columns(self) -> list[Quantity]:
        """Its components as a quantity each, position_1 and so on; itself where it has none."""
        about = self.units, self.description, self.frame
        return [
            Quantity(f"{self.name}_{part}", symbol, *about, label=self._headed(symbol))
            for part, symbol in zip(self.components, self.symbols, strict=True)
        ] or [self]


def _table(text: str) -> dict[str, Quantity]:
    """Quantities by name, one a line: name, symbol, units, description, kind and label.

    A line that begins with a space goes on with the last one.
    kind: nothing for a number, one of `_KINDS`, or "mean" for a vector of mean values.
    """
    found = {}
    for line in text.replace("\n ", " ").strip().splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        name, symbol, units, description, kind, label = cells + [""] * (6 - len(cells))
        frame, shape, components, parts = _KINDS.get(kind, ("space", (3,), _XYZ, ()))
        if kind == "mean":
            parts = tuple(rf"\langle {symbol}_{i}\rangle" for i in _XYZ)
            symbol = rf"\langle {symbol}\rangle"
        found[name] = Quantity(
            name, symbol, units, description, frame, shape, components, parts, label
        )
    return found


_KINDS: dict[str, tuple[str, tuple[int, ...], tuple[str, ...], tuple[str, ...]]] = {
    "": ("", (), (), ()),
    "vector": ("space", (3,), _XYZ, ()),
    "quaternion": ("body to space", (4,), ("0", *_XYZ), ()),
    "angles": ("body to space", (3,), _ANGLES, _ANGLE_SYMBOLS),
    "tensor": ("space", (6,), _PAIRS, tuple(rf"\sigma_{{{pair}}}" for pair in _PAIRS)),
    "stresses": ("space", (6,), _PAIRS, ()),
    "matrix": ("body", (6, 6), (), ()),
    "square": ("space", (3, 3), (), ()),
    "nine": ("space", (3, 3), tuple(f"{i}{j}" for i in "123" for j in "123"), ()),
    "axes": ("space", (3,), (), ()),
    "five": ("", (5,), ("0", "1", "2", "3", "4"), ()),
    "four": ("", (4,), ("0", "1", "2", "3"), ()),
    "numbers": ("", (4,), ("0", "1", "2", "1_held"), ("S_0", "S_1", "S_2", "S_1^{held}")),
    "modes": ("", (3,), ("X", "Y", "Z"), ("X^M", "Y^M", "Z^M")),
}

TIME = Quantity("time", "t", "tau", "instants of the samples")
INSTANT = Quantity("time", "t", "tau", "instants of the field")
TRAJECTORY = Quantity("trajectory", "", "1", "number of the trajectory")
SAMPLE = Quantity("sample", "", "1", "number of the sample")

# Of a motion, at every sample.
MOTION = _table(r"""
position         | x      | c          | centre of the body                | vector
orientation      | q      | 1          | unit quaternion, scalar first     | quaternion
axis             | D^3    | 1          | symmetry axis D3                  | vector
velocity         | V      | c/tau      | velocity of the centre            | vector
angular_velocity | \Omega | 1/tau      | angular velocity                  | vector
force            | F      | mu c^2/tau | hydrodynamic force on the body    | vector
torque           | M      | mu c^3/tau | hydrodynamic torque on the body   | vector
euler_angles     | \mathrm{angle} | rad | phi, theta, psi of R3 R1 R3      | angles
orbit_constant | C | 1 | Jeffery's orbit constant in the shear at the start: infinite when tumbling
""")

# Of a motion as well, where it is asked for: what the body adds to the stress of a suspension. The
# others are per volume fraction, in units of mu times the rate sqrt(2 E:E) at the centre.
STRESS = _table(r"""
stresslet           | S        | mu c^3/tau | stresslet, with that of the torque       | stresses
particle_stress     | \Sigma   | 1 | stress over volume fraction, mu and rate, all parts | stresses
acceleration_stress | \Sigma^A | 1 | its part from the particle's acceleration           | stresses
reynolds_stress     | \Sigma^R | 1 | its part from the particle's motion past the flow   | stresses
brownian_stress     | \Sigma^B | 1 | its part from rotary Brownian motion                | stresses
""")
RECORDABLE = MOTION | STRESS

# Of an event, in the order in which they are recorded; half-turns have some more.
EVENT = {
    **_table("time | t | tau | instant of the event"),
    **{name: MOTION[name] for name in ("position", "axis", "velocity")},
    **_table("orbit_constant | C | 1 | orbit constant in the shear at the start of the motion"),
}
HALF_TURN = EVENT | _table(r"""
period | T         | tau | time since the last half-turn but one
drift  | \Delta x  | c   | displacement since the last half-turn but one | vector
""")


# Of an event among bodies that share a fluid.
MEETING = _table("""
time     | t | tau | instant of the event
body     |   | 1   | number of the body, from 1
other    |   | 1   | number of the other body; 0: the wall, or none
gap      | g | c   | least gap of the scene
position | x | c   | centre of the body | vector
""")


def of_event(name: str, coupled: bool = False) -> dict[str, Quantity]:
    """What is recorded of the events of one name; coupled: among bodies that share a fluid."""
    if coupled:
        return MEETING
    return HALF_TURN if name == "half_turns" else EVENT


def of_bodies(quantity: Quantity, count: int) -> Quantity:
    """A quantity of one body as that of several, (body, ...)."""
    return replace(quantity, shape=(count, *quantity.shape))


# Of the flow around a body: what may be asked for, what every point has, what its surface has.
FLUID = _table(r"""
velocity             | u      | c/tau  | velocity of the fluid                          | vector
disturbance_velocity | u'     | c/tau  | velocity minus that of the background flow     | vector
pressure             | p      | mu/tau | pressure, with that of the background flow
stress               | \sigma | mu/tau | stress tensor                                  | tensor
gradient             | \nabla u | 1/tau | velocity gradient, d u_i / d x_j               | nine
pressure_gradient    | \nabla p | mu/(c tau) | gradient of the pressure                   | vector
""")
POINT = _table("""
points | x | c | points                                                                | vector
inside |   | 1 | point in the body
source |   | 1 | 0 plain, 1 graded quadrature, 2 QBX, 3 table; -1 in the body
""")
SURFACE = _table("""
traction | f | mu/tau | force of the fluid on the body per area | vector
normals  | n | 1      | outward unit normals                    | vector
""")

# Of a whole trajectory: what the table of a sweep says after the swept values.
SUMMARY = _table(r"""
period          | T          | tau | twice the mean time of a half-turn of the axis
period_change | \Delta T/T | 1
   | period over the later half of the half-turns minus earlier, relative
half_turns      |            | 1   | whole half-turns of the axis that averages are taken over
rotation_rate | \langle\Omega\rangle | 1/tau
  | mean rate of the axis about stream x gradient: negative in a shear u = (x2, 0, 0)
  | | mean rotation rate $\langle\Omega\rangle$
mean_velocity | V | c/tau | mean velocity over whole half-turns | mean
velocity_change | \Delta V | c/tau | mean velocity over the later half-turns minus the earlier
   | mean
orbit_constant_start | C | 1 | orbit constant in the local shear at the first sample
   || orbit constant $C$ at the start
orbit_constant_end | C | 1 | orbit constant in the local shear at the last sample
   || orbit constant $C$ at the end
orbit_drift | \mathrm{d}\ln C/\mathrm{d}t | 1/tau | mean rate of the logarithm of the orbit constant
jeffery_period  | T | tau | Jeffery's period in the gradient at the start || Jeffery's period $T$
end             | t | tau | last instant || last instant $t$
final_position         | x      | c     | position at the end                    | vector
final_orientation      | q      | 1     | orientation quaternion at the end      | quaternion
final_velocity         | V      | c/tau | velocity at the end                    | vector
final_angular_velocity | \Omega | 1/tau | angular velocity at the end, in space  | vector
steps           |  | 1 | steps of its block
rhs_evaluations | | 1 | right-hand sides of its block, each for every trajectory in it
   || right-hand sides
error_estimate  |  | 1 | error accepted in the integration, and the body model's over time
wall_time       |  | s | wall time of its block over the number of trajectories in it
""")


def _columns(quantities: dict[str, Quantity]) -> dict[str, Quantity]:
    """The same with one number per name, as a table has it."""
    return {column.name: column for whole in quantities.values() for column in whole.columns()}


COLUMNS = _columns(SUMMARY)

# Of a body without a motion: its law, in a flow what it does there, and what forming it took.
BODY = _table(r"""
resistance | R | mu c, mu c^3 | force and torque on the body are -R (velocity, angular velocity)
   | matrix
mobility | M | 1/(mu c), 1/(mu c^3)
   | (velocity, angular velocity) are M (force, torque) from outside | matrix
linear     | \lambda | 1   | Omega = w/2 + linear D3 x (E D3) in a linear flow
quadratic  | q | c^2 | coefficients of the free velocity's second derivatives of the flow | five
cubic | c | c^2 | coefficients of the free angular velocity's third derivatives of the flow | four
stresslet_numbers | S | mu c^3 | S0, S1, S2 of the free body's stresslet, and S1 of the held one
   | numbers
kim_karrila | M | 1 | S0, held S1 and S2 over 20 pi/3 times the longer semi-axis cubed | modes
free_velocity         | U      | c/tau      | velocity of the free body         | vector
free_angular_velocity | \Omega | 1/tau      | angular velocity of the free body | vector
held_force            | F      | mu c^2/tau | force on the body held fixed      | vector
held_torque           | M      | mu c^3/tau | torque on the body held fixed     | vector
""")
# Of bodies that share a fluid, or of one by a wall: (body, ...) or all bodies together.
COUPLED = {
    **{name: RECORDABLE[name] for name in ("position", "axis", "stresslet")},
    **{name: BODY[name] for name in BODY if name.startswith(("free_", "held_"))},
    **_table(r"""
resistance | R | mu c, mu c^2, mu c^3 | (force, torque) by the bodies on the fluid are R (velocity,
   angular velocity), body after body, about their centres, in space
mobility | M | 1/(mu c), ... | the inverse of the resistance
"""),
}
_FORMING = _table(r"""
setup_time | | s | time to form the body: the median where measured || set-up time
iterations | | 1 | GMRES iterations of all solves
error      | | 1 | largest error against closed forms and references
""")
# Of a measured trajectory, besides and in the place of the other columns.
MEASURED = {
    **_table("wall_time | | s | wall time of the motion, without set-up: the median"),
    "setup_time": _FORMING["setup_time"],
    **_table("rejected | | 1 | rejected steps"),
    "iterations": _FORMING["iterations"],
    "error": _FORMING["error"],
}
BODY_COLUMNS = {
    **_table(r"""
resistance_translation_transverse | R^{\mathrm{t}}_{1} | mu c
   | resistance to translation, transverse || resistance to translation, transverse
resistance_translation_axial | R^{\mathrm{t}}_{3} | mu c | resistance to translation, axial
   || resistance to translation, axial
resistance_rotation_transverse | R^{\mathrm{r}}_{1} | mu c^3 | resistance to rotation, transverse
   || resistance to rotation, transverse
resistance_rotation_axial | R^{\mathrm{r}}_{3} | mu c^3 | resistance to rotation, axial
   || resistance to rotation, axial
"""),
    **_columns({name: BODY[name] for name in BODY if len(BODY[name].shape) < 2}),
    **_table("error_estimate | | 1 | estimated error of resistance and free motion, relative"),
    "error": _FORMING["error"],
    "iterations": _FORMING["iterations"],
    **_table("true_residual | | 1 | largest true residual of the solves, relative"),
    "setup_time": _FORMING["setup_time"],
    **_table(r"""
n_theta         | n_\vartheta | 1 | nodes along a meridian  | | $n_\vartheta$
n_phi           | n_\phi      | 1 | nodes around the axis   | | $n_\phi$
expansion_order | p           | 1 | order of the expansions
nodes           |             | 1 | nodes on the surface
"""),
}

# Of a suspension: at each Peclet number and each instant, in units of mu times the rate.
RHEOLOGY = _table(r"""
peclet_number | \mathrm{Pe} | 1 | rate of the flow over rotary diffusivity, infinite without it
   || Peclet number $\mathrm{Pe}$
intrinsic_viscosity | [\eta] | 1 | particle stress along E over volume fraction and rate
   || intrinsic viscosity $[\eta]$
first_normal_stress_difference  | N_1 | 1 | Sigma_11 - Sigma_22 over volume fraction, mu and rate
second_normal_stress_difference | N_2 | 1 | Sigma_22 - Sigma_33 over volume fraction, mu and rate
particle_stress | \Sigma | 1 | particle stress over volume fraction, mu and rate | square
hydrodynamic_stress | \Sigma^H | 1 | its part from the mean stresslet | square
brownian_stress | \Sigma^B | 1 | its part from rotary Brownian motion | square
inertial_stress | \Sigma^I | 1 | its part from the particles' own inertia | square
order_tensor | \langle pp\rangle | 1 | mean of the products of the axis' components | square
error_estimate | | 1 | estimated relative error of the stress
theta | \vartheta | rad | angle from e3 of the distribution's axes
phi | \varphi | rad | angle from e1 about e3 of the distribution's axes
distribution | \psi | 1 | density of axes on the unit sphere, by theta and phi, of integral 1
strain | \gamma | 1 | strain of an oscillation
strain_rate | \dot\gamma | 1 | rate of an oscillation over its amplitude
""")
RHEOLOGY |= _table(r"""
samples | p | 1 | axes drawn from each density, for each Peclet number | axes
paths | p | 1 | axes of single Brownian trajectories that were kept | axes
mean_square_displacement | \langle\Delta x\Delta x\rangle | c^2
   | of places since the start, by the flow and by diffusion | square
""")
# Of means over Brownian trajectories, in units of what they are an error of.
RHEOLOGY |= {
    f"{name}_standard_error": replace(
        whole, name=f"{name}_standard_error", description=f"standard error of {name}"
    )
    for name, whole in RHEOLOGY.items()
    if name.endswith(("viscosity", "difference", "stress", "tensor", "displacement"))
}

# Of an ensemble, for B bodies: what is looked at, of which the datasets hold statistics.
LOOKED_AT = _table(r"""
tumbling     | \dot p^2 | 1/tau^2 | squared rate at which the axis turns
spinning     | (\Omega\cdot p)^2 | 1/tau^2 | squared rate of rotation about the axis
cos_vorticity | \cos(p,\omega) | 1 | cosine, without sign, of the angle of axis and vorticity
cos_strain_1 | \cos(p,e_1) | 1 | cosine, without sign, of the angle to the most stretching axis
cos_strain_2 | \cos(p,e_2) | 1 | cosine, without sign, of the angle to the second axis of strain
cos_strain_3 | \cos(p,e_3) | 1 | cosine, without sign, of the angle to the most compressing axis
""")
ENSEMBLE = _table(r"""
time | t | tau | instants at which paths are looked at
lag | \tau | tau | lags of the correlation
correlation | \langle p(0)\cdot p(\tau)\rangle | 1 | correlation of the axis, by lag and body
axis | p | 1 | axes of the first paths, by path, instant and body | vector
""")
_STATISTICS = {
    "moments": "means of powers 1 to 4, by body",
    "moments_error": "standard errors of these means over paths, by body",
    "over_strain": "mean over <E:E> = epsilon/(2 nu), by body",
    "over_strain_error": "standard error of that ratio, by body",
    "edges": "edges of bins",
    "counts": "numbers below, in and beyond the bins, by body",
    "in_time": "means over paths, by instant and body",
    "spread_in_time": "standard deviations over paths, by instant and body",
}


def of_ensemble(name: str) -> Quantity:
    """What is known of a dataset of an ensemble, or of a swept value of its bodies."""
    for looked in LOOKED_AT.values():
        part = name.removeprefix(f"{looked.name}_")
        if part != name and part in _STATISTICS:
            told = f"{looked.description}: {_STATISTICS[part]}"
            return Quantity(name, looked.symbol, looked.units, told)
    if (known := RHEOLOGY.get(name)) is not None:
        stress = name.removesuffix("_standard_error").endswith("stress")
        told = known.description.replace(", mu and rate", " and mu")
        return replace(known, units="1/tau", description=told) if stress else known
    return ENSEMBLE.get(name) or PARAMETER.get(name) or Quantity(name, "", "", f"swept {name}")


STRAIN_TIME = Quantity("time", r"\dot\gamma t", "1/rate", "instants, by the rate of the flow")

# Of a scene of several bodies or a wall, in the table of a sweep.
COUPLED_COLUMNS = _table(r"""
gap             | g | c   | least gap of the scene, in a motion at its samples
end             | t | tau | last instant || last instant $t$
steps           |   | 1   | steps of the integrator
rhs_evaluations |   | 1   | right-hand sides
iterations      |   | 1   | GMRES iterations
error_estimate  |   | 1   | estimated error of the velocities, or of the resistance, relative
wall_time       |   | s   | wall time
""")

STATUS = _table("""
status | | | 0 missing, 1 done, 2 failed
reason | | | why it failed, or ended before the last instant
""")

# Of a case: keys that have a symbol, by their names in the table of a sweep.
PARAMETER = _table(r"""
aspect_ratio      | k            | 1   | k = a/c, equatorial over polar radius
stokes_number | \mathrm{St} | 1 | St, particle inertia over viscous force
   || Stokes number $\mathrm{St}$
start_euler_phi   | \varphi_0    | rad | phi at the start   || $\varphi$ at the start
start_euler_theta | \theta_0     | rad | theta at the start || $\theta$ at the start
start_euler_psi   | \psi_0       | rad | psi at the start   || $\psi$ at the start
upsampling        | \kappa       | 1   | factor of the finer grid
""")


_COLUMN = MEASURED | BODY_COLUMNS | COLUMNS | PARAMETER


def column(name: str) -> Quantity:
    """What a column of the table of a sweep is; one that is not listed is its name alone."""
    return _COLUMN.get(name.removeprefix("hydrodynamics_")) or Quantity(name, "", "", "")
