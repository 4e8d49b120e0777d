"""Sections `bodies` and `surroundings`: several bodies in one fluid, and the wall beside them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from qbxstokes.case.model import Direction, Positive, Reader, Section, Vector, key, several
from qbxstokes.case.scene import WITH_FLOW, Body, Forces, Start
from qbxstokes.case.values import Key, Problem, at, describe, meant, refuse
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.tables import TableError, read_datasets, read_table

# What a scene with several bodies or a wall aims at where the case does not say.
TOLERANCE = 1e-6
MOST = 1000


class Surroundings(Section):
    """What bounds the fluid: nothing, or a plane wall."""

    type: Literal["wall", "unbounded"] = key("what bounds the fluid", example="wall")
    normal: Direction = key("normal of the wall, into the fluid; normalised", (0.0, 1.0, 0.0))
    point: Vector = key("a point of the wall", (0.0, 0.0, 0.0))
    velocity: Vector = key("of the wall, in its plane: that of the flow there", (0.0, 0.0, 0.0))

    def _check(self) -> None:
        given = sorted(self.given_keys - {"type"})
        if self.type == "unbounded" and given:
            raise Problem("has no meaning for type: unbounded", "leave it out", (given[0],))


class Repulsion(Section):
    """A short-range force strength exp(-gap/range) that keeps bodies apart, and off the wall."""

    strength: Positive = key("force at contact (mu c^2/tau)", example=10.0)
    range: Positive = key("gap over which it falls by e", example=0.02)


class BodyEntry(Body):
    """One of several bodies: its shape and size, where it starts, and what acts on it."""

    size: Positive = key("polar radius c in the scene's unit of length", 1.0)
    start: Start = key("position and orientation at time 0", Start())
    forces: Forces | None = key(
        "external force and torque, gravity; unset: those of the section forces", None
    )


_MANY = several(BodyEntry)


def _bodies(value: Any) -> tuple[BodyEntry, ...]:
    if not isinstance(value, (list, tuple)):
        right = "a list of bodies, or {table: FILE} of CSV or HDF5"
        raise Problem(f"is {describe(value)}", right)
    if not 1 <= len(value) <= MOST:
        raise Problem(f"holds {len(value)} bodies", f"1 to {MOST}")
    return _MANY.read(value)


_TABLE = {
    "type": "object",
    "properties": {"table": {"type": "string"}},
    "required": ["table"],
    "additionalProperties": False,
}
BODIES = Reader(_bodies, {"anyOf": [_MANY.json, _TABLE]}, BodyEntry, listed=True)
Bodies = Annotated[tuple[BodyEntry, ...], BODIES]

# Columns of a table of bodies, named as in results: where their numbers go in an entry.
_COLUMNS: dict[str, tuple[str, ...]] = {
    **{name: (name,) for name in ("aspect_ratio", "length_over_diameter", "size", "stokes_number")},
    "position": ("start", "position"),
    "axis": ("start", "orientation", "axis"),
    "orientation": ("start", "orientation", "quaternion"),
    "force": ("forces", "force"),
    "torque": ("forces", "torque"),
}
_PARTS = {"position": "123", "axis": "123", "orientation": "0123", "force": "123", "torque": "123"}


def expanded(value: Any, folder: Path) -> Any:
    """`bodies` with a table in place of its name as the list it stands for; raises Problem."""
    if not isinstance(value, dict) or set(value) != {"table"}:
        return value
    with at("table"):
        if not isinstance(value["table"], str):
            raise Problem(f"is {describe(value['table'])}", "the name of a CSV or HDF5 file")
        path = folder / value["table"]
        held = _datasets(path) if path.suffix in (".h5", ".hdf5") else _columns(path)
        bodies: list[dict[str, Any]] = [{} for _ in next(iter(held.values()))]
        for name, numbers in held.items():
            *sections, last = _COLUMNS[name]
            for body, number in zip(bodies, numbers, strict=True):
                for section in sections:
                    body = body.setdefault(section, {})
                body[last] = number
        return bodies


def _columns(path: Path) -> dict[str, list[Any]]:
    """Quantities of a CSV file with a row for each body, a component a column (position_1)."""
    try:
        table = read_table(path)
    except TableError as error:
        raise Problem(str(error), "a header and one line a body") from None
    held = dict(zip(table.names, table.numbers.T.tolist(), strict=False))
    parts_of = {n: [f"{n}_{part}" for part in _PARTS.get(n, "")] or [n] for n in _COLUMNS}
    known = [part for parts in parts_of.values() for part in parts]
    for name in held or ("",):
        if name not in known:
            right = meant(name, known, f"columns of {', '.join(known)}")
            raise Problem(f"{path}: {name or 'has no header'} is no column", right)
    found: dict[str, list[Any]] = {}
    for name, parts in parts_of.items():
        if lacking := [part for part in parts if part not in held]:
            if len(lacking) < len(parts):
                raise Problem(f"{path}: {lacking[0]} is missing", f"all components of {name}")
            continue
        rows = zip(*(held[part] for part in parts), strict=True)
        found[name] = [list(row) if name in _PARTS else row[0] for row in rows]
    return found


def _datasets(path: Path) -> dict[str, list[Any]]:
    """The same of an HDF5 file with a dataset of each quantity: position (N, 3), size (N,)."""
    try:
        found = read_datasets(path)
    except TableError as error:
        right = "datasets such as aspect_ratio (N,) and position (N, 3)"
        raise Problem(str(error), right) from None
    for name, values in found.items():
        width = (len(_PARTS[name]),) if name in _PARTS else ()
        if name not in _COLUMNS or values.shape[1:] != width:
            wrong = f"{path}: {name}, of shape {values.shape}, is no quantity of bodies"
            raise Problem(wrong, meant(name, _COLUMNS, f"some of {', '.join(_COLUMNS)}"))
    return {name: values.tolist() for name, values in found.items()}


# Keys that have no meaning where bodies share a fluid or feel a wall.
_ALONE = "with a wall or several bodies"
_FOREIGN: dict[Key, str] = {
    ("time", "periods"): "give time.end: bodies that feel each other or a wall have no period",
    ("constraints",): "leave it out: all bodies are free",
    ("rheology",): "leave it out, or use one body in an unbounded fluid",
    ("field", "method"): "leave it out: harmonics of all bodies",
    ("field", "force"): "give it in the section forces",
    ("field", "torque"): "give it in the section forces",
    ("field", "velocity"): "leave it out: free or held",
    ("field", "angular_velocity"): "leave it out: free or held",
}
_TOLERANT = {
    "hydrodynamics": ("tolerance", "solve", "cache"),
    "events": ("clearance", "turning_points"),
    "compare": ("reference",),
}


def coupled(data: dict[str, Any]) -> bool:
    """Whether the plain data of a case have several bodies or a wall."""
    around = data.get("surroundings")
    return bool(data.get("bodies")) or (isinstance(around, dict) and around.get("type") == "wall")


def prepared(data: dict[str, Any], task: str) -> dict[str, Any]:
    """The data of a coupled scene with its own defaults; raises Problem for what it cannot have."""
    data, filled = dict(data), {name: value for name, value in data.items() if value != {}}
    around = data.get("surroundings")
    walled = isinstance(around, dict) and around.get("type") == "wall"
    many = not walled or (isinstance(data.get("bodies"), (list, tuple)) and len(data["bodies"]) > 1)
    if data.get("bodies"):
        bodies = data["bodies"] if isinstance(data["bodies"], list) else []
        if task != "motion" and any(b.get("stokes_number") for b in bodies if isinstance(b, dict)):
            raise Problem("hold a stokes_number", "none: nothing moves", ("bodies",))
        refuse(filled, dict.fromkeys((("body",), ("start",)), "give it in bodies"), "beside bodies")
    refuse(filled, _FOREIGN, _ALONE)
    for section, known in _TOLERANT.items():
        given = data.get(section)
        for name in given if isinstance(given, dict) else ():
            if name not in known:
                raise Problem(f"has no meaning {_ALONE}", "leave it out", (section, name))
    given = data.get("hydrodynamics")
    if given is None or (isinstance(given, dict) and "solve" not in given):
        data["hydrodynamics"] = {**(given or {}), "solve": "every_step"}
    elif isinstance(given, dict) and given["solve"] == "functional" and many:
        right = "every_step: a table is one of a single body by a wall"
        raise Problem("has no meaning for several bodies", right, ("hydrodynamics", "solve"))
    for section in ("hydrodynamics", "time", "field"):
        given = data.get(section)
        if given is None and section == "hydrodynamics":
            given = {}
        if isinstance(given, dict) and "tolerance" not in given:
            held = data["hydrodynamics"] if section == "field" else None
            inherited = held["tolerance"] if isinstance(held, dict) else TOLERANCE
            data[section] = {**given, "tolerance": inherited}
    if isinstance(data.get("field"), dict):
        data["field"] = _field(data["field"], bool(data.get("bodies")))
    return data


def _field(given: dict[str, Any], listed: bool) -> dict[str, Any]:
    """Section `field` of bodies that share a fluid, whose points are in space where listed."""
    if given.get("body") == "moving":
        right = "free, with the section forces, or held"
        raise Problem(f"has no meaning {_ALONE}", right, ("field", "body"))
    found = dict(given)
    for name in ("plane", "box", "points", "streamlines", "tracers") if listed else ():
        points = {} if name in given and given[name] is None else given.get(name)
        if not isinstance(points, dict):
            continue
        if points.get("frame", "space") != "space":
            raise Problem("is not space", "space: bodies share it", ("field", name, "frame"))
        found[name] = {**points, "frame": "space"}
    return found


def check_members(members: Sequence[BodyEntry], forces: Forces, listed: bool) -> None:
    """Refuse what bodies cannot have, by themselves or together; raises Problem."""
    for index, body in enumerate(members):
        with at(*(("bodies", index) if listed else ())):
            own = () if listed else ("body",)
            if bool(body.stokes_number) != bool(members[0].stokes_number):
                wrong, right = "mixes bodies with and without inertia", "all of them, or none"
                raise Problem(wrong, right, (*own, "stokes_number"))
            for name in ("velocity", "angular_velocity"):
                given = getattr(body.start, name) != WITH_FLOW
                if given != (getattr(members[0].start, name) != WITH_FLOW):
                    raise Problem("is not given of all", "of all bodies, or none", ("start", name))
                if given and not body.stokes_number:
                    wrong = "has no meaning for a massless body (stokes_number: 0)"
                    right = "leave it out, or give the body a stokes_number > 0"
                    raise Problem(wrong, right, ("start", name))
            gravity = (body.forces or forces).gravity
            if gravity is not None and gravity.number is None and not body.stokes_number:
                right = "give number, G = (rho_p - rho_f) g c tau/mu, of a massless body's weight"
                path = ("forces", "gravity", "acceleration")
                raise Problem("needs a stokes_number > 0", right, path)


def check_coupled(members: Sequence[BodyEntry], listed: bool) -> None:
    """Refuse bodies that cannot share a fluid, or feel a wall; raises Problem."""
    for index, body in enumerate(members):
        own = ("bodies", index) if listed else ("body",)
        if body.inertia != "both":
            raise Problem("is not both", "both, beside others or a wall", (*own, "inertia"))
        if body.shape is not None and not isinstance(body.outline, Spheroid):
            raise Problem("is no spheroid", "spheroids: gaps are theirs", (*own, "shape"))
