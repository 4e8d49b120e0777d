"""Section `field`: where the flow around the body is wanted, which quantities, how accurately."""

from typing import Annotated, Any, Literal

from qbxstokes.case.model import (
    NAME,
    VECTOR,
    Instants,
    Positive,
    Section,
    Tolerance,
    Vector,
    choice,
    key,
    number,
    several,
    some,
    whole,
)
from qbxstokes.case.values import Problem, increasing
from qbxstokes.quantities import FLUID

ORIGIN = (0.0, 0.0, 0.0)
Frame = Literal["centre", "space", "body"]
AXES = "axes of space about the body's centre, space itself, or the body's own axes"
_COUNT = whole(ge=1, le=100_000)
Pair = Annotated[tuple[int, int], several(_COUNT, "[201, 201]")]
Triple = Annotated[tuple[int, int, int], several(_COUNT, "[41, 41, 41]")]
Rectangle = Annotated[tuple[float, float, float, float], several(number(), "[-3, 3, -3, 3]")]
Samples = Annotated[int, whole(ge=2, le=1_000_000)]
_USUAL = ("velocity", "disturbance_velocity", "pressure", "stress")


class Plane(Section):
    """A rectangle of points in a plane."""

    origin: Vector = key("point of the plane at (0, 0)", ORIGIN)
    first: Vector = key("direction of the first coordinate", (1.0, 0.0, 0.0))
    second: Vector = key("direction of the second, made orthogonal to the first", (0.0, 1.0, 0.0))
    extent: Rectangle = key(
        "least and largest first, least and largest second coordinate", (-3.0, 3.0, -3.0, 3.0)
    )
    shape: Pair = key("numbers of points in both directions", (201, 201))
    frame: Frame = key(AXES, "centre")

    def _check(self) -> None:
        a, b = self.first, self.second
        cross = [a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1))]
        if max(map(abs, cross)) <= 1e-9 * max(map(abs, a)) * max(map(abs, b)):
            raise Problem("is parallel to first, or zero", "another direction", ("second",))
        for low, high in ((0, 1), (2, 3)):
            if self.extent[low] >= self.extent[high]:
                raise Problem("is not increasing", "such as [-3, 3, -3, 3]", ("extent",))


class Box(Section):
    """A regular grid of points in a box along the axes of its frame."""

    lower: Vector = key("corner of least coordinates", (-3.0, -3.0, -3.0))
    upper: Vector = key("corner of largest coordinates", (3.0, 3.0, 3.0))
    shape: Triple = key("numbers of points along the axes", (41, 41, 41))
    frame: Frame = key(AXES, "centre")

    def _check(self) -> None:
        if any(a >= b for a, b in zip(self.lower, self.upper, strict=True)):
            raise Problem("is not beyond lower", "larger in every coordinate", ("upper",))


class Shells(Section):
    """Surfaces at given distances from the body, along its normals."""

    distances: Annotated[tuple[float, ...], some(number(ge=0))] = key(
        "distances from the surface, in lengths c", (0.0, 0.01, 0.1, 1.0)
    )
    shape: Pair = key("numbers of points in theta and phi", (33, 64))

    def _check(self) -> None:
        increasing(self.distances, "distances")


class Points(Section):
    """Points from a file."""

    file: Annotated[str, NAME] = key(
        "beside the case: CSV (three numbers a line, header or not) or NPY (N, 3)",
        example="points.csv",
    )
    frame: Frame = key(AXES, "centre")


class Surface(Section):
    """The body's surface with the traction on it."""

    shape: Pair = key("numbers of points in theta and phi", (49, 96))


class Lines(Section):
    """Where lines start: on a segment, or at listed points."""

    start: Vector = key("first end of the segment of starting points", (-3.0, -1.0, 0.0))
    stop: Vector = key("second end of the segment of starting points", (-3.0, 1.0, 0.0))
    number: Annotated[int, whole(ge=1, le=10_000)] = key(
        "number of starting points on the segment", 21
    )
    points: Annotated[tuple[tuple[float, ...], ...], some(VECTOR)] | None = key(
        "starting points one by one; replaces the segment", None, [[-3.0, 0.5, 0.0]]
    )
    frame: Frame = key(AXES, "centre")
    tolerance: Tolerance = key("error control of the lines, relative and absolute", 1e-8)


class Streamlines(Lines):
    """Lines along the velocity relative to the body, at one instant."""

    length: Positive = key("length of each line, in lengths c", 8.0)
    both_ways: bool = key("follow the lines upstream from their starting points as well", False)
    samples: Samples = key("points stored on each line", 201)


class Tracers(Lines):
    """Particles carried by the flow while the body moves, from time 0."""

    duration: Positive | None = key("end of the paths; unset: that of the motion", None, 10.0)
    samples: Samples = key("instants stored", 201)


class FieldSection(Section):
    """The flow around the body."""

    plane: Plane | None = key("points in a plane", None)
    box: Box | None = key("points in a box", None)
    shells: Shells | None = key("points at distances from the body", None)
    points: Points | None = key("points listed in a file", None)
    surface: Surface | None = key("traction on the body", Surface())
    streamlines: Streamlines | None = key("streamlines", None)
    tracers: Tracers | None = key("paths of tracers", None)
    quantities: Annotated[tuple[str, ...], some(choice(*FLUID))] = key(
        "quantities to store at the points; also gradient, pressure_gradient", _USUAL
    )
    tolerance: Tolerance = key("error of the velocity, relative to the largest disturbance", 1e-8)
    method: Literal["auto", "table", "quadrature"] = key(
        "by table where its error allows, by the table alone, or by QBX and quadrature", "auto"
    )
    body: Literal["free", "held", "moving"] = key(
        "task: field: free (with force and torque), held fixed, or in given motion", "free"
    )
    force: Vector = key("outer force on a free body, in space", ORIGIN)
    torque: Vector = key("outer torque on a free body, in space", ORIGIN)
    velocity: Vector = key("velocity of a moving body, in space", ORIGIN)
    angular_velocity: Vector = key("angular velocity of a moving body, in space", ORIGIN)
    every: Annotated[int, whole(ge=1)] | None = key(
        "task: motion: at every so many stored instants; unset: the last one alone", None, 10
    )
    at: Instants | None = key(
        "task: motion: at these instants, which must be among the stored ones", None, [0.0, 1.0]
    )
    check: Annotated[int, whole(ge=0, le=1_000_000)] = key(
        "points where QBX and quadrature check the table (some ten a second); more than 6 are "
        "spread over the plane and stored",
        6,
    )
    vtk: bool = key("write a .vtkhdf file for ParaView beside the result", True)
    pictures: bool = key("draw PDF pictures beside the result", False)

    def _check(self) -> None:
        meant = {"force": "free", "torque": "free"}
        meant |= {"velocity": "moving", "angular_velocity": "moving"}
        for name, body in meant.items():
            if name in self.given_keys and self.body != body:
                wrong = f"has no meaning for body: {self.body}"
                raise Problem(wrong, f"leave it out or set body: {body}", (name,))
        if self.at is not None and self.every is not None:
            raise Problem("conflicts with at", "give one of them", ("every",))
        wanted: list[Any] = [self.plane, self.box, self.shells, self.points]
        wanted += [self.surface, self.streamlines, self.tracers]
        if all(entry is None for entry in wanted):
            raise Problem("asks for nothing", "such as `plane: {}`")
