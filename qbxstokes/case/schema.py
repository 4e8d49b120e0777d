"""The schema of a case: which sections there are, and what must agree between them.

A new section is one class and one key of `Case`; a new task is one word in `Task`.
"""

import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from qbxstokes.case.bodies import (
    Bodies,
    BodyEntry,
    Repulsion,
    Surroundings,
    check_coupled,
    check_members,
    coupled,
    prepared,
)
from qbxstokes.case.field import FieldSection
from qbxstokes.case.model import Key, Reader, Section, key, maybe
from qbxstokes.case.rheology import RheologySection
from qbxstokes.case.running import (
    Brownian,
    Checkpoints,
    Compare,
    Events,
    Hydrodynamics,
    Output,
    Statistics,
    Time,
)
from qbxstokes.case.scene import FREE, WITH_FLOW, Body, Constraints, FlowSection, Forces, Start
from qbxstokes.case.sweep import Sweep
from qbxstokes.case.units import Units, nondimensional
from qbxstokes.case.values import Problem, describe, refuse
from qbxstokes.solver_options import foreign_to_a_case, misleading

# Keys that have no meaning for a task: "what would be right": their names. They are refused where
# they are given, and starter cases leave them out.
_FOREIGN = {
    "motion": {
        "leave it out": "field.body field.force field.torque field.velocity field.angular_velocity",
        "leave it out, or use task: rheology": "rheology",
    },
    "field": {
        "leave it out, or use task: motion": "constraints time events sweep statistics brownian",
        "leave it out": "field.every field.at",
        "give field.force and field.torque": "forces",
        "give field.velocity, with field.body: moving": "start.velocity",
        "give field.angular_velocity, with field.body: moving": "start.angular_velocity",
        "leave it out: the flow at one instant knows no inertia": "body.stokes_number body.inertia",
        "leave it out: it chooses among the samples of a motion": "output.fields",
        "leave it out, or use task: rheology": "rheology",
    },
    "rheology": {
        "leave it out: the suspension is dilute": "bodies surroundings",
        "leave it out, or use task: motion": "forces constraints time events checkpoint sweep "
        "statistics",
        "leave it out, or use task: field": "field",
        "give rheology.peclet_number and rheology.langevin": "brownian",
        "leave it out: orientations are told by rheology.orientations": "start.orientation",
        "leave it out: nothing moves": "start.velocity start.angular_velocity",
        "leave it out: it chooses among the samples of a motion": "output.fields",
    },
    "body": {
        "leave it out, or use task: motion": "forces constraints time events checkpoint "
        "statistics brownian",
        "leave it out, or use task: field": "field",
        "leave it out, or use task: rheology": "rheology",
        "leave it out: nothing moves": "start.velocity start.angular_velocity body.stokes_number "
        "body.inertia",
        "leave it out: the body is always formed anew": "hydrodynamics.cache",
        "leave it out: a body has no samples": "sweep.store sweep.block sweep.discard",
        "leave it out: it chooses among the samples of a motion": "output.fields",
    },
}
FOREIGN = {
    task: {tuple(name.split(".")): right for right, names in keys.items() for name in names.split()}
    for task, keys in _FOREIGN.items()
}
# Keys that belong to a section.
_WITHIN = {
    name: (f"belongs to {section}", f"write {section}: {{{name}: ...}}")
    for section, names in {
        "start": "position orientation velocity angular_velocity axis",
        "body": "aspect_ratio length_over_diameter shape stokes_number",
        "forces": "force torque gravity",
        "time": "end periods samples tolerance",
        "units": "viscosity length rate body_density fluid_density",
    }.items()
    for name in names.split()
}
# Tasks and sections that have left the program.
_MOVED = {
    "benchmark": ("has moved", "run the scripts in cases/benchmarks"),
    "stress": ("has moved", "run the tests in tests/stress"),
    "study": ("has moved", "run the scripts in cases/studies"),
}


def _petsc_options(value: Any) -> Any:
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise Problem(f"is {describe(value)}", "options as keys, such as `ts_type: rk`")
    for name, option in value.items():
        if isinstance(option, (dict, list)):
            raise Problem(f"is {describe(option)}", "one value per option", (name,))
        if not name.lstrip("-") or any(c.isspace() or not c.isprintable() for c in name):
            raise Problem("is not an option's name", "a name such as ts_monitor", (name,))
        if isinstance(option, str) and not option.isprintable():
            raise Problem("holds control characters", "printable text", (name,))
    options = {name.lstrip("-"): option for name, option in value.items()}
    for rule in (foreign_to_a_case, misleading):
        for name, wrong, right in rule(options):
            key = name if name in value else f"-{name}"
            raise Problem(wrong, right, (key,))
    return options


_VALUES = {"type": ["string", "number", "boolean", "null"]}
PETSC_OPTIONS = Reader(_petsc_options, {"type": "object", "additionalProperties": _VALUES})


class Case(Section, **_MOVED, **_WITHIN):
    """One case: what to compute, for which body in which flow, and how.

    body, flow, time, field, rheology and sweep are None where they are not given; a task has those
    that it needs.
    """

    task: Literal["motion", "field", "body", "rheology"] = key("what to compute", "motion")
    title: str = key("a line that names the case in summaries", "")
    body: Body = key("the body; of several: bodies", None)
    bodies: Bodies | None = key(
        "several bodies in one fluid: a list of bodies, or {table: FILE} (CSV, HDF5)",
        None,
        [{"aspect_ratio": 0.5}, {"aspect_ratio": 1.0, "size": 2.0}],
    )
    surroundings: Surroundings | None = key("what bounds the fluid; unset: nothing", None)
    repulsion: Repulsion | None = key(
        "a short-range force between bodies, and off the wall; unset: none", None
    )
    units: Units | None = key("physical scales; other keys then take numbers with units", None)
    flow: Annotated[FlowSection, maybe(FlowSection)] = key(
        "the background flow (unset: none, with task: body or bodies)"
    )
    start: Start = key("state at time 0", Start())
    forces: Forces = key("external force and torque, gravity", Forces())
    constraints: Constraints = key("parts of the motion that are held or prescribed", Constraints())
    time: Annotated[Time, maybe(Time)] = key("duration, stored instants, tolerance", None)
    hydrodynamics: Hydrodynamics = key(
        "accuracy and scheme of the integral equation", Hydrodynamics()
    )
    field: Annotated[FieldSection, maybe(FieldSection)] = key(
        "the flow around the body: where, which quantities, how well", None
    )
    rheology: Annotated[RheologySection, maybe(RheologySection)] = key(
        "a dilute suspension of the body in a homogeneous flow", None
    )
    events: Events = key("what is watched for between samples", Events())
    checkpoint: Checkpoints = key("how often the run is made safe on disk", Checkpoints())
    petsc: Annotated[dict[str, Any], PETSC_OPTIONS] = key(
        "PETSc options without the dash; the command line overrides them", {}, {"ts_monitor": None}
    )
    sweep: Annotated[Sweep, maybe(Sweep)] = key(
        "vary keys of the case: many trajectories, one result", None
    )
    brownian: Brownian | None = key("random turns of the axes of bodies in sweeps", None)
    statistics: Statistics = key(
        "what a sweep with store: statistics keeps of bodies along paths", Statistics()
    )
    output: Output = key("the result file", Output())
    compare: Compare = key("what to hold the result against", Compare())

    @classmethod
    def _prepare(cls, data: Any) -> Any:
        """Complete what the task leaves out, refuse what has no meaning for it.

        A section whose keys are all commented out is one of defaults, or left out where it may be.
        """
        if not isinstance(data, dict):
            return data
        if data.get("units") is not None:
            data = nondimensional(data)
        opened = {name for name, k in cls.declared.items() if k.reader.section and k.default}
        opened.add("body")
        data = {n: {} if value is None and n in opened else value for n, value in data.items()}
        task = data.get("task", "motion")
        if isinstance(task, str) and task in _MOVED:
            wrong, right = _MOVED[task]
            raise Problem(f"{task} {wrong}", right, ("task",))
        if not isinstance(task, str) or task not in FOREIGN:
            return data
        together = coupled(data)
        loaded = {("forces",)} if together else set()
        foreign = {path: right for path, right in FOREIGN[task].items() if path not in loaded}
        refuse(data, foreign, f"for task: {task}")
        if together:
            data = prepared(data, task)
        if task == "rheology":
            data = {**data, "rheology": data.get("rheology") or {}}
        return {**data, "flow": data.get("flow") or None} if task == "body" or together else data

    def _check(self) -> None:
        if self.body is None and self.bodies is None:
            right = f"the body, with the keys {', '.join(Body.declared)}; for several: bodies"
            raise Problem("is missing", right, ("body",))
        if self.task == "motion" and self.time is None:
            raise Problem("is missing", "task: motion needs it, with end, periods or at", ("time",))
        if self.task == "field":
            if self.field is None:
                raise Problem("is missing", "task: field needs it, such as `plane: {}`", ("field",))
            if self.field.tracers is not None and self.field.tracers.duration is None:
                right, path = "task: field needs the end of the paths", ("tracers", "duration")
                raise Problem("is missing", right, ("field", *path))
            if self.field.tracers is not None and self.coupled and self.field.body != "held":
                wrong = "would follow bodies that do not stay as they are"
                right = "task: motion, or field.body: held"
                raise Problem(wrong, right, ("field", "tracers"))
        if self.flow is None and not self.coupled:
            wrong, right = "has no meaning without a flow", "leave it out, or give one"
            if "start" in self.given_keys:
                raise Problem(wrong, right, ("start",))
            if self.hydrodynamics.solve == "every_step":
                raise Problem(wrong, right, ("hydrodynamics", "solve"))
        listed = self.bodies is not None
        check_members(self.members, self.forces, listed)
        if self.coupled:
            check_coupled(self.members, listed)
        else:
            if self.repulsion is not None:
                wrong = "has no meaning for one body in an unbounded fluid"
                raise Problem(wrong, "leave it out", ("repulsion",))
            for bound, moving in (("translation", "velocity"), ("rotation", "angular_velocity")):
                held = getattr(self.constraints, bound) != FREE
                if held and getattr(self.start, moving) != WITH_FLOW:
                    wrong = f"has no meaning with constraints.{bound}"
                    raise Problem(wrong, "leave it out", ("start", moving))
            self._check_uniform_radius()

    @property
    def wall(self) -> Surroundings | None:
        """The wall, None where the fluid is unbounded."""
        around = self.surroundings
        return around if around is not None and around.type == "wall" else None

    @property
    def coupled(self) -> bool:
        """Whether bodies share the fluid, or feel a wall."""
        return self.bodies is not None or self.wall is not None

    @property
    def members(self) -> tuple[BodyEntry, ...]:
        """The bodies of the scene, each with its start and its forces."""
        if self.bodies is not None:
            return self.bodies
        return (BodyEntry(**vars(self.body), start=self.start),)

    def _check_uniform_radius(self) -> None:
        """Refuse a global expansion radius that leaves the ball touching the surface in one point.

        r = 2 pi (r/h) / n_theta must not exceed the least admissible radius of the surface.
        """
        shape, n = self.body.outline, self.hydrodynamics.n_theta
        ratio = self.hydrodynamics.r_over_h
        if n is None or ratio is None:
            return
        limit = shape.least_radius
        radius = 2 * math.pi * ratio / n
        if radius > limit:
            raise Problem(
                f"r = 2 pi r_over_h / n_theta = {radius:.4g} leaves the admissible ball, "
                f"r <= {limit:.4g} of the {shape}",
                f"r_over_h <= {limit * n / (2 * math.pi):.4g} for this n_theta",
                ("hydrodynamics", "r_over_h"),
            )


def keys(model: type[Section] = Case, prefix: str = "") -> Iterator[tuple[str, Key]]:
    """Every key of the case by its dotted name, sections before their keys."""
    for name, declared in model.declared.items():
        yield prefix + name, declared
        if declared.reader.section:
            yield from keys(declared.reader.section, f"{prefix}{name}.")
