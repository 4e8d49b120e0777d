"""The schema of a case: which sections there are, and what must agree between them.

Each section lives in its own module and owns its keys with their defaults and descriptions. A new
section is one new module and one field of `Case`; a new task is one word in `Task`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from qbxstokes.case.base import Text, describe
from qbxstokes.case.body import Body
from qbxstokes.case.checkpoint import Checkpoints
from qbxstokes.case.compare import Compare
from qbxstokes.case.constraints import FREE, Constraints
from qbxstokes.case.events import Events
from qbxstokes.case.field import FieldSection
from qbxstokes.case.flow import FlowSection
from qbxstokes.case.forces import Forces
from qbxstokes.case.hydrodynamics import Hydrodynamics
from qbxstokes.case.model import Convert, Field, FieldInfo, Key, Problem, Section, section_of
from qbxstokes.case.output import Output
from qbxstokes.case.start import Start
from qbxstokes.case.sweep import Sweep
from qbxstokes.case.time import Time

Task = Literal["motion", "field", "body"]

# Sections, and keys of sections, that have no meaning for a task, and what would be right instead.
# They are refused where they are given, and starter cases leave them out.
_ONE_INSTANT = "leave it out, or use task: motion"
_STILL = "leave it out: nothing moves"
_MOVING = ("forces", "constraints", "time", "events", "checkpoint")
_SAMPLING = ("store", "block", "discard")
FOREIGN: dict[str, dict[tuple[str, ...], str]] = {
    "motion": {
        ("field", name): "leave it out"
        for name in ("body", "force", "torque", "velocity", "angular_velocity")
    },
    "field": {
        **{(name,): _ONE_INSTANT for name in ("constraints", "time", "events")},
        ("sweep",): _ONE_INSTANT,
        **{("field", name): "leave it out" for name in ("every", "at")},
        ("forces",): "give field.force and field.torque",
        ("start", "velocity"): "give field.velocity, with field.body: moving",
        ("start", "angular_velocity"): "give field.angular_velocity, with field.body: moving",
        ("body", "stokes_number"): "leave it out: the flow at one instant knows no inertia",
        ("body", "inertia"): "leave it out: the flow at one instant knows no inertia",
    },
    "body": {
        **{(name,): "leave it out, or use task: motion" for name in _MOVING},
        ("field",): "leave it out, or use task: field",
        **{("start", name): _STILL for name in ("velocity", "angular_velocity")},
        **{("body", name): _STILL for name in ("stokes_number", "inertia")},
        ("hydrodynamics", "cache"): "leave it out: the body is always formed anew",
        **{("sweep", name): "leave it out: a body has no samples" for name in _SAMPLING},
    },
}
_SAMPLES = "leave it out: it chooses among the samples of a motion"
for _task, _keys in FOREIGN.items():
    _keys |= {} if _task == "motion" else {("output", "fields"): _SAMPLES}

PetscValue = str | int | float | bool | None


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
    return {name.lstrip("-"): option for name, option in value.items()}


class Case(Section):
    """One case: what to compute, for which body in which flow, and how."""

    task: Task = Field(default="motion", description="what to compute")
    title: Text = Field(default="", description="a line that names the case in summaries")
    body: Body = Field(description="the spheroid")
    flow: FlowSection | None = Field(
        description="the background flow (task: body: may be left out)"
    )
    start: Start = Field(default=Start(), description="state at time 0")
    forces: Forces = Field(default=Forces(), description="external force and torque, gravity")
    constraints: Constraints = Field(
        default=Constraints(),
        description="parts of the motion that are held or prescribed",
    )
    time: Time | None = Field(default=None, description="duration, stored instants, tolerance")
    hydrodynamics: Hydrodynamics = Field(
        default=Hydrodynamics(),
        description="accuracy and scheme of the integral equation",
    )
    field: FieldSection | None = Field(
        default=None, description="the flow around the body: where, which quantities, how well"
    )
    events: Events = Field(default=Events(), description="what is watched for between samples")
    checkpoint: Checkpoints = Field(
        default=Checkpoints(), description="how often the run is made safe on disk"
    )
    petsc: Annotated[
        dict[str, PetscValue],
        Convert(_petsc_options, json=dict[str, PetscValue]),
    ] = Field(
        default={},
        description="PETSc options without the leading dash; the command line overrides them",
        examples=[{"ts_monitor": None}],
    )
    sweep: Sweep | None = Field(
        default=None, description="vary keys of the case: many trajectories, one result"
    )
    output: Output = Field(default=Output(), description="the result file")
    compare: Compare = Field(default=Compare(), description="what to hold the result against")

    @classmethod
    def _prepare(cls, data: Any) -> Any:
        """Refuse what has no meaning for the task."""
        if not isinstance(data, dict):
            return data
        task = data.get("task", "motion")
        if not isinstance(task, str) or task not in FOREIGN:
            return data
        for key, right in FOREIGN[task].items():
            holder: Any = data
            for part in key[:-1]:
                holder = holder.get(part) if isinstance(holder, dict) else None
            if isinstance(holder, dict) and holder.get(key[-1]) is not None:
                raise Problem(f"has no meaning for task: {task}", right, key)
        if task == "body" and not data.get("flow"):
            return {**data, "flow": None}
        return data

    def _check(self) -> None:
        if self.task == "motion" and self.time is None:
            raise Problem("is missing", "task: motion needs it, with end, periods or at", ("time",))
        if self.task == "field":
            if self.field is None:
                raise Problem("is missing", "task: field needs it, such as `plane: {}`", ("field",))
            tracers = self.field.tracers
            if tracers is not None and tracers.duration is None:
                key = ("field", "tracers", "duration")
                raise Problem("is missing", "task: field needs the end of the paths", key)
        if self.flow is None:
            self._check_alone()
        self._check_forces()
        if self.body.stokes_number == 0:
            for name in ("velocity", "angular_velocity"):
                if getattr(self.start, name) != "with_flow":
                    raise Problem(
                        "has no meaning for a massless body (stokes_number: 0)",
                        "leave it out, or give the body a stokes_number > 0",
                        ("start", name),
                    )
        self._check_uniform_radius()

    def _check_alone(self) -> None:
        """Refuse what only a flow gives a meaning to."""
        if "start" in self.model_fields_set:
            raise Problem("has no meaning without a flow", "leave it out, or give one", ("start",))
        if self.hydrodynamics.solve == "every_step":
            key = ("hydrodynamics", "solve")
            raise Problem("has no meaning without a flow", "leave it out, or give one", key)

    def _check_forces(self) -> None:
        """Refuse weights without mass, and starts that a constraint leaves no room for."""
        gravity = self.forces.gravity
        if gravity is not None and gravity.number is None and self.body.stokes_number == 0:
            raise Problem(
                "needs a stokes_number > 0",
                "give number, G = (rho_p - rho_f) g c tau/mu, of a massless body's weight",
                ("forces", "gravity", "acceleration"),
            )
        for bound, moving in (("translation", "velocity"), ("rotation", "angular_velocity")):
            given = getattr(self.start, moving) != "with_flow"
            if given and getattr(self.constraints, bound) != FREE:
                wrong = f"has no meaning with constraints.{bound}"
                raise Problem(wrong, "leave it out", ("start", moving))

    def _check_uniform_radius(self) -> None:
        """Refuse a global expansion radius that leaves the ball touching the surface in one point.

        r = 2 pi (r/h) / n_theta must not exceed the least of k q, q / k and q^3 / k over the
        surface: min(k^2, 1) min(1, 1/k) = k^2 for k <= 1 and 1/k for k > 1.
        """
        scheme = self.hydrodynamics
        if scheme.scheme != "uniform" or scheme.r_over_h is None or scheme.n_theta is None:
            return
        k = self.body.aspect_ratio
        limit = k * k if k <= 1 else 1 / k
        radius = 2 * math.pi * scheme.r_over_h / scheme.n_theta
        if radius > limit:
            formula = "k^2" if k <= 1 else "1/k"
            raise Problem(
                f"r = 2 pi r_over_h / n_theta = {radius:.4g} leaves the admissible ball, "
                f"r <= {formula} = {limit:.4g}",
                f"r_over_h <= {limit * scheme.n_theta / (2 * math.pi):.4g} for this n_theta",
                ("hydrodynamics", "r_over_h"),
            )


def keys(model: type[Section] = Case, prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """Every key of the case with its field, sections before their keys."""
    for name, field in model.model_fields.items():
        yield prefix + name, field
        inner = section_of(field.annotation)
        if inner:
            yield from keys(inner, f"{prefix}{name}.")


def section_at(key: Key) -> type[Section] | None:
    """The section class that `key` leads to, or None where it leads to a plain value."""
    model: type[Section] | None = Case
    for part in key:
        if model is None or part not in model.model_fields:
            return None
        model = section_of(model.model_fields[str(part)].annotation)
    return model
