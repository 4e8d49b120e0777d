"""The section `units`: physical scales, and keys that may then be given with a unit."""

from contextlib import suppress
from typing import Annotated, Any

from qbxstokes.case.model import Reader, Section, key
from qbxstokes.case.values import Problem, at, describe
from qbxstokes.errors import SceneError
from qbxstokes.expressions import expression_in_time
from qbxstokes.units import GIVEN, Scales, has_unit

# Keys that take a unit, by the scale of theirs; entries of lists alike, those of `bodies` and of
# the terms of a sum as in the section itself.
_KEYS = {
    "c": "start.position events.clearance events.region.lower events.region.upper "
    "field.plane.origin field.plane.extent field.box.lower field.box.upper field.shells.distances "
    "field.streamlines.start field.streamlines.stop field.streamlines.points "
    "field.streamlines.length field.tracers.start field.tracers.stop field.tracers.points "
    "surroundings.point flow.position flow.half_width flow.radius flow.length flow.singular_points",
    "tau": "time.end time.at field.tracers.duration",
    "c/tau": "start.velocity surroundings.velocity flow.velocity flow.speed flow.value "
    "constraints.translation",
    "1/tau": "start.angular_velocity flow.rate flow.angular_velocity flow.gradient "
    "constraints.rotation",
    "1/(c tau)": "flow.curvature flow.hessian",
    "1/(c^2 tau)": "flow.third",
    "mu c^2/tau": "forces.force forces.body_force",
    "mu c^3/tau": "forces.torque forces.body_torque",
}
UNITS_OF = {name: units for units, names in _KEYS.items() for name in names.split()}
_STRENGTH = {"stokeslet": "mu c^2/tau", "rotlet": "mu c^3/tau", "stresslet": "mu c^3/tau"}


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise Problem(f"is {describe(value)}", "a number with its unit, such as 10 um or 5 1/s")
    return value


QUANTITY = Reader(_text, {"type": "string"})


Optional = Annotated[str | None, QUANTITY]


class Units(Section):
    """Physical scales: c, tau and mu with their units, and densities that give St and G."""

    length: Annotated[str, QUANTITY] = key(
        "the length c (polar radius), such as 10 um", example=GIVEN["length"][1]
    )
    rate: Optional = key("1/tau, such as a shear rate", None, GIVEN["rate"][1])
    time: Optional = key("tau, in the place of rate", None, GIVEN["time"][1])
    viscosity: Optional = key("mu of the fluid", None, GIVEN["viscosity"][1])
    body_density: Optional = key(
        "rho_b, gives stokes_number = rho_b c^2/(mu tau)", None, GIVEN["body_density"][1]
    )
    fluid_density: Optional = key("rho_f of the fluid", None, GIVEN["fluid_density"][1])
    gravity: Optional = key(
        "g, gives forces.gravity.number = (rho_b - rho_f) g c tau/mu", None, GIVEN["gravity"][1]
    )

    @property
    def scales(self) -> Scales:
        """The scales; raises Problem where a text is no quantity of its kind."""
        try:
            return Scales({name: getattr(self, name) for name in self.declared})
        except SceneError as error:
            raise Problem(error.wrong, error.right, tuple(error.key.split("."))) from None


def nondimensional(data: dict[str, Any]) -> dict[str, Any]:
    """A case with its `units` in units of c, tau and mu: St, G and every number with a unit."""
    with at("units"):
        section = Units.read(data["units"])
    scales = section.scales
    converted = dict(_plain(data, (), scales))
    task = data.get("task", "motion")
    if scales.stokes_number is not None and task in ("motion", "rheology"):
        if "body" in converted:
            converted["body"] = _heavy(converted["body"], scales, ("body",))
        if isinstance(many := converted.get("bodies"), list):
            converted["bodies"] = [_heavy(b, scales, ("bodies", n)) for n, b in enumerate(many)]
    weight = scales.gravity_number
    if weight is not None and task == "motion":
        forces = converted.get("forces") or {}
        given = forces.get("gravity") or {}
        for name in ("number", "acceleration", "density_ratio"):
            if given.get(name) is not None:
                wrong, right = "stands beside units.gravity", "leave one of them out"
                raise Problem(wrong, right, ("forces", "gravity", name))
        converted["forces"] = {**forces, "gravity": {**given, "number": weight}}
    return converted


def _heavy(body: Any, scales: Scales, path: tuple[str | int, ...]) -> Any:
    """The keys of a body with its Stokes number."""
    if not isinstance(body, dict):
        return body
    if body.get("stokes_number") is not None:
        wrong, right = "stands beside units.body_density", "leave one of them out"
        raise Problem(wrong, right, (*path, "stokes_number"))
    return {**body, "stokes_number": scales.stokes_number}


def _plain(value: Any, path: tuple[str | int, ...], scales: Scales) -> Any:
    if path[:1] in (("units",), ("title",), ("output",), ("petsc",), ("sweep",)):
        return value
    if isinstance(value, dict):
        strength = _STRENGTH.get(str(value.get("type"))) if path[:1] == ("flow",) else None
        return {
            name: _number(entry, (*path, name), strength, scales)
            if strength and name == "strength"
            else _plain(entry, (*path, name), scales)
            for name, entry in value.items()
        }
    if isinstance(value, list):
        return [_plain(entry, (*path, place), scales) for place, entry in enumerate(value)]
    words = [part for part in path if isinstance(part, str) and part not in ("terms", "bodies")]
    if words[:2] == ["flow", "flow"]:  # of one that is transformed
        words = words[1:]
    units = UNITS_OF.get(".".join(words))
    return value if units is None else _number(value, path, units, scales)


def _number(value: Any, path: tuple[str | int, ...], units: str, scales: Scales) -> Any:
    if isinstance(value, list):
        return [_number(v, (*path, place), units, scales) for place, v in enumerate(value)]
    if not has_unit(value):
        return value
    with suppress(ValueError, TypeError, ArithmeticError):
        expression_in_time(value)(0.0)
        return value  # arithmetic, of t too
    try:
        return scales.plain(value, units)
    except ValueError as error:
        right = "see `help units` for the keys that take one"
        raise Problem(f"{describe(value)} {error}", right, path) from None
