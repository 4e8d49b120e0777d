"""The one list of what can be recorded: every quantity with its symbol, units, frame and shape.

Result files, pictures, exports, summaries, the schema of a case and the pages read it;
`motion.observables` computes those of a motion. Everything is nondimensional: length c (polar
radius), time tau, force mu c^2/tau, torque mu c^3/tau. Symbols are LaTeX.
"""

from dataclasses import replace

from qbxstokes.quantity import Quantity, table

TIME = Quantity("time", "t", "tau", "instants of the samples")
INSTANT = Quantity("time", "t", "tau", "instants of the field")
TRAJECTORY = Quantity("trajectory", "", "1", "number of the trajectory")
SAMPLE = Quantity("sample", "", "1", "number of the sample")

# Of a motion, at every sample.
MOTION = table(r"""
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
STRESS = table(r"""
stresslet           | S        | mu c^3/tau | stresslet, with that of the torque       | stresses
particle_stress     | \Sigma   | 1 | stress over volume fraction, mu and rate, all parts | stresses
acceleration_stress | \Sigma^A | 1 | its part from the particle's acceleration           | stresses
reynolds_stress     | \Sigma^R | 1 | its part from the particle's motion past the flow   | stresses
brownian_stress     | \Sigma^B | 1 | its part from rotary Brownian motion                | stresses
""")
RECORDABLE = MOTION | STRESS

# Of an event, in the order in which they are recorded; half-turns have some more.
EVENT = {
    **table("time | t | tau | instant of the event"),
    **{name: MOTION[name] for name in ("position", "axis", "velocity")},
    **table("orbit_constant | C | 1 | orbit constant in the shear at the start of the motion"),
}
HALF_TURN = EVENT | table(r"""
period | T         | tau | time since the last half-turn but one
drift  | \Delta x  | c   | displacement since the last half-turn but one | vector
""")


# Of an event among bodies that share a fluid.
MEETING = table("""
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
    return replace(quantity, shape=(count, *quantity.shape), several=True)


# Of the flow around a body: what may be asked for, what every point has, what its surface has.
FLUID = table(r"""
velocity             | u      | c/tau  | velocity of the fluid                          | vector
disturbance_velocity | u'     | c/tau  | velocity minus that of the background flow     | vector
pressure             | p      | mu/tau | pressure, with that of the background flow
stress               | \sigma | mu/tau | stress tensor                                  | tensor
gradient             | \nabla u | 1/tau | velocity gradient, d u_i / d x_j               | nine
pressure_gradient    | \nabla p | mu/(c tau) | gradient of the pressure                   | vector
""")
POINT = table("""
points | x | c | points                                                                | vector
inside |   | 1 | point in the body
source |   | 1 | 0 plain, 1 graded quadrature, 2 QBX, 3 table; -1 in the body
""")
SURFACE = table("""
traction | f | mu/tau | force of the fluid on the body per area | vector
normals  | n | 1      | outward unit normals                    | vector
""")

# Of a whole trajectory: what the table of a sweep says after the swept values.
SUMMARY = table(r"""
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
BODY = table(r"""
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
    **{
        name: replace(RECORDABLE[name], lead=("body",))
        for name in ("position", "axis", "stresslet")
    },
    **{
        name: replace(whole, lead=("body",))
        for name, whole in BODY.items()
        if name.startswith(("free_", "held_"))
    },
    **table(r"""
resistance | R | mu c, mu c^2, mu c^3 | (force, torque) by the bodies on the fluid are R (velocity,
   angular velocity), body after body, about their centres, in space
   ||| resistance_row resistance_column
mobility | M | 1/(mu c), ... | the inverse of the resistance ||| mobility_row mobility_column
"""),
}
_FORMING = table(r"""
setup_time | | s | time to form the body: the median where measured || set-up time
iterations | | 1 | GMRES iterations of all solves
error      | | 1 | largest error against closed forms and references
""")
# Of a measured trajectory, besides and in the place of the other columns.
MEASURED = {
    **table("wall_time | | s | wall time of the motion, without set-up: the median"),
    "setup_time": _FORMING["setup_time"],
    **table("rejected | | 1 | rejected steps"),
    "iterations": _FORMING["iterations"],
    "error": _FORMING["error"],
}
BODY_COLUMNS = {
    **table(r"""
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
    **table("error_estimate | | 1 | estimated error of resistance and free motion, relative"),
    "error": _FORMING["error"],
    "iterations": _FORMING["iterations"],
    **table("true_residual | | 1 | largest true residual of the solves, relative"),
    "setup_time": _FORMING["setup_time"],
    **table(r"""
n_theta         | n_\vartheta | 1 | nodes along a meridian  | | $n_\vartheta$
n_phi           | n_\phi      | 1 | nodes around the axis   | | $n_\phi$
expansion_order | p           | 1 | order of the expansions
nodes           |             | 1 | nodes on the surface
"""),
}

# Of a suspension: at each Peclet number and each instant, in units of mu times the rate.
RHEOLOGY = table(r"""
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
theta | \vartheta | rad | angle from e3 of the distribution's axes ||| theta
phi | \varphi | rad | angle from e1 about e3 of the distribution's axes ||| phi
distribution | \psi | 1 | density of axes on the unit sphere, by theta and phi, of integral 1
   ||| peclet_number theta phi
strain | \gamma | 1 | strain of an oscillation ||| time
strain_rate | \dot\gamma | 1 | rate of an oscillation over its amplitude ||| time
""")
RHEOLOGY |= table(r"""
samples | p | 1 | axes drawn from each density, for each Peclet number | axes
   || peclet_number sample
paths | p | 1 | axes of single Brownian trajectories that were kept | axes
   || peclet_number time path
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
_BY_NUMBER = ("peclet_number", "time")
RHEOLOGY = {n: replace(whole, lead=whole.lead or _BY_NUMBER) for n, whole in RHEOLOGY.items()}

# Of an ensemble, for B bodies: what is looked at, of which the datasets hold statistics.
LOOKED_AT = table(r"""
tumbling     | \dot p^2 | 1/tau^2 | squared rate at which the axis turns
spinning     | (\Omega\cdot p)^2 | 1/tau^2 | squared rate of rotation about the axis
cos_vorticity | \cos(p,\omega) | 1 | cosine, without sign, of the angle of axis and vorticity
cos_strain_1 | \cos(p,e_1) | 1 | cosine, without sign, of the angle to the most stretching axis
cos_strain_2 | \cos(p,e_2) | 1 | cosine, without sign, of the angle to the second axis of strain
cos_strain_3 | \cos(p,e_3) | 1 | cosine, without sign, of the angle to the most compressing axis
""")
ENSEMBLE = table(r"""
time | t | tau | instants at which paths are looked at ||| time
lag | \tau | tau | lags of the correlation ||| lag
correlation | \langle p(0)\cdot p(\tau)\rangle | 1 | correlation of the axis, by lag and body
   ||| lag body
axis | p | 1 | axes of the first paths, by path, instant and body | vector || path sample body
""")
_STATISTICS = {
    "moments": ("means of powers 1 to 4, in these powers of the unit, by body", "body power"),
    "moments_error": ("standard errors of these means over paths, by body", "body power"),
    "over_strain": ("mean over <E:E> = epsilon/(2 nu), by body", "body"),
    "over_strain_error": ("standard error of that ratio, by body", "body"),
    "edges": ("edges of bins", "edge"),
    "counts": ("numbers below, in and beyond the bins, by body", "body bin"),
    "in_time": ("means over paths, by instant and body", "time body"),
    "spread_in_time": ("standard deviations over paths, by instant and body", "time body"),
}


def of_ensemble(name: str) -> Quantity:
    """What is known of a dataset of an ensemble, or of a swept value of its bodies."""
    for looked in LOOKED_AT.values():
        part = name.removeprefix(f"{looked.name}_")
        if part != name and part in _STATISTICS:
            of_it, lead = _STATISTICS[part]
            told = f"{looked.description}: {of_it}"
            units = "1" if part == "counts" or part.startswith("over_strain") else looked.units
            return Quantity(name, looked.symbol, units, told, lead=tuple(lead.split()))
    if (known := RHEOLOGY.get(name)) is not None:
        stress = name.removesuffix("_standard_error").endswith("stress")
        told = known.description.replace(", mu and rate", " and mu")
        known = replace(known, lead=("body",))
        return replace(known, units="1/tau", description=told) if stress else known
    swept = PARAMETER.get(name) or Quantity(name, "", "", f"swept {name}")
    return ENSEMBLE.get(name) or replace(swept, lead=("body",))


_TOLD = "instants, by the rate of the flow"
STRAIN_TIME = Quantity("time", r"\dot\gamma t", "1/rate", _TOLD, lead=("time",))

# Of a scene of several bodies or a wall, in the table of a sweep.
COUPLED_COLUMNS = table(r"""
gap             | g | c   | least gap of the scene, in a motion at its samples
end             | t | tau | last instant || last instant $t$
steps           |   | 1   | steps of the integrator
rhs_evaluations |   | 1   | right-hand sides
iterations      |   | 1   | GMRES iterations
error_estimate  |   | 1   | expected error at the end, or that of the resistance, relative
wall_time       |   | s   | wall time
""")

STATUS = table("""
status | | | 0 missing, 1 done, 2 failed
reason | | | why it failed, or ended before the last instant
""")

# Of a case: keys that have a symbol, by their names in the table of a sweep.
PARAMETER = table(r"""
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
