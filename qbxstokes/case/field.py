"""Section `field`: where the flow around the body is wanted, which quantities, how accurately."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from qbxstokes.case.base import Boolean, Integer, Number, Text, Vector, entries
from qbxstokes.case.model import Convert, Field, Problem, Section
from qbxstokes.quantities import FLUID

if TYPE_CHECKING:
    Fluid = str
else:
    Fluid = Literal[tuple(FLUID)]
Frame = Literal["centre", "space", "body"]
FRAME = "axes of space about the body's centre, space itself, or the body's own axes"

_Count = Annotated[Integer, Field(ge=1, le=100_000)]
Rectangle = Annotated[
    tuple[Number, Number, Number, Number],
    Convert(entries(4, "[-3, 3, -3, 3]"), json=list[float | str]),
]
Pair = Annotated[
    tuple[_Count, _Count],
    Convert(entries(2, "[201, 201]"), json=list[int]),
]
Triple = Annotated[
    tuple[_Count, _Count, _Count],
    Convert(entries(3, "[41, 41, 41]"), json=list[int]),
]


class Plane(Section):
    """A rectangle of points in a plane."""

    origin: Vector = Field(default=(0.0, 0.0, 0.0), description="point of the plane at (0, 0)")
    first: Vector = Field(default=(1.0, 0.0, 0.0), description="direction of the first coordinate")
    second: Vector = Field(
        default=(0.0, 1.0, 0.0),
        description="direction of the second, made orthogonal to the first",
    )
    extent: Rectangle = Field(
        default=(-3.0, 3.0, -3.0, 3.0),
        description="least and largest first, least and largest second coordinate",
    )
    shape: Pair = Field(default=(201, 201), description="numbers of points in both directions")
    frame: Frame = Field(default="centre", description=FRAME)

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

    lower: Vector = Field(default=(-3.0, -3.0, -3.0), description="corner of least coordinates")
    upper: Vector = Field(default=(3.0, 3.0, 3.0), description="corner of largest coordinates")
    shape: Triple = Field(default=(41, 41, 41), description="numbers of points along the axes")
    frame: Frame = Field(default="centre", description=FRAME)

    def _check(self) -> None:
        if any(a >= b for a, b in zip(self.lower, self.upper, strict=True)):
            raise Problem("is not beyond lower", "larger in every coordinate", ("upper",))


class Shells(Section):
    """Surfaces at given distances from the body, along its normals."""

    distances: Annotated[tuple[Annotated[Number, Field(ge=0)], ...], Field(min_length=1)] = Field(
        default=(0.0, 0.01, 0.1, 1.0), description="distances from the surface, in lengths c"
    )
    shape: Pair = Field(default=(33, 64), description="numbers of points in theta and phi")

    def _check(self) -> None:
        for index in range(1, len(self.distances)):
            if self.distances[index] <= self.distances[index - 1]:
                raise Problem("does not increase", "increasing distances", ("distances", index))


class Points(Section):
    """Points from a file."""

    file: Annotated[Text, Field(min_length=1)] = Field(
        description="CSV (three numbers a line, header allowed) or NPY (N, 3), beside the case",
        examples=["points.csv"],
    )
    frame: Frame = Field(default="centre", description=FRAME)


class Surface(Section):
    """The body's surface with the traction on it."""

    shape: Pair = Field(default=(49, 96), description="numbers of points in theta and phi")


class Lines(Section):
    """Where lines start: on a segment, or at listed points."""

    start: Vector = Field(
        default=(-3.0, -1.0, 0.0), description="first end of the segment of starting points"
    )
    stop: Vector = Field(
        default=(-3.0, 1.0, 0.0), description="second end of the segment of starting points"
    )
    number: Annotated[Integer, Field(ge=1, le=10_000)] = Field(
        default=21, description="number of starting points on the segment"
    )
    points: Annotated[tuple[Vector, ...], Field(min_length=1)] | None = Field(
        default=None,
        description="starting points one by one; replaces the segment",
        examples=[[[-3.0, 0.5, 0.0], [-3.0, 0.0, 0.5]]],
    )
    frame: Frame = Field(default="centre", description=FRAME)
    tolerance: Annotated[Number, Field(gt=0, le=0.1)] = Field(
        default=1e-8, description="error control of the lines, relative and absolute"
    )


class Streamlines(Lines):
    """Lines along the velocity relative to the body, at one instant."""

    length: Annotated[Number, Field(gt=0)] = Field(
        default=8.0, description="length of each line, in lengths c"
    )
    both_ways: Boolean = Field(
        default=False, description="follow the lines upstream from their starting points as well"
    )
    samples: Annotated[Integer, Field(ge=2, le=1_000_000)] = Field(
        default=201, description="points stored on each line"
    )


class Tracers(Lines):
    """Particles carried by the flow while the body moves, from time 0."""

    duration: Annotated[Number, Field(gt=0)] | None = Field(
        default=None,
        description="end of the paths; unset: that of the motion",
        examples=[10.0],
    )
    samples: Annotated[Integer, Field(ge=2, le=1_000_000)] = Field(
        default=201, description="instants stored"
    )


class FieldSection(Section):
    """The flow around the body."""

    plane: Plane | None = Field(default=None, description="points in a plane")
    box: Box | None = Field(default=None, description="points in a box")
    shells: Shells | None = Field(default=None, description="points at distances from the body")
    points: Points | None = Field(default=None, description="points listed in a file")
    surface: Surface | None = Field(default=Surface(), description="traction on the body")
    streamlines: Streamlines | None = Field(default=None, description="streamlines")
    tracers: Tracers | None = Field(default=None, description="paths of tracers")
    quantities: Annotated[tuple[Fluid, ...], Field(min_length=1)] = Field(
        default=tuple(FLUID),
        description="quantities to store at the points",
    )
    tolerance: Annotated[Number, Field(gt=0, le=0.1)] = Field(
        default=1e-8, description="error of the velocity, relative to the largest disturbance"
    )
    method: Literal["auto", "table", "quadrature"] = Field(
        default="auto",
        description="by table where its error allows, by the table alone, or by QBX and quadrature",
    )
    body: Literal["free", "held", "moving"] = Field(
        default="free",
        description="task: field: free (with force and torque), held fixed, or in given motion",
    )
    force: Vector = Field(
        default=(0.0, 0.0, 0.0), description="outer force on a free body, in space"
    )
    torque: Vector = Field(
        default=(0.0, 0.0, 0.0), description="outer torque on a free body, in space"
    )
    velocity: Vector = Field(
        default=(0.0, 0.0, 0.0), description="velocity of a moving body, in space"
    )
    angular_velocity: Vector = Field(
        default=(0.0, 0.0, 0.0), description="angular velocity of a moving body, in space"
    )
    every: Annotated[Integer, Field(ge=1)] | None = Field(
        default=None,
        description="task: motion: at every so many stored instants; unset: the last one alone",
        examples=[10],
    )
    at: Annotated[tuple[Number, ...], Field(min_length=1)] | None = Field(
        default=None,
        description="task: motion: at these instants, which must be among the stored ones",
        examples=[[0.0, 1.0]],
    )
    check: Annotated[Integer, Field(ge=0, le=1_000_000)] = Field(
        default=6,
        description="points at which QBX and quadrature check the table (some ten a second); more "
        "than 6 are spread over the plane and stored",
    )
    vtk: Boolean = Field(
        default=True, description="write a .vtkhdf file for ParaView beside the result"
    )
    pictures: Boolean = Field(default=False, description="draw PDF pictures beside the result")

    def _check(self) -> None:
        given = self.model_fields_set
        for names, body in (
            (("force", "torque"), "free"),
            (("velocity", "angular_velocity"), "moving"),
        ):
            for name in names:
                if name in given and self.body != body:
                    raise Problem(
                        f"has no meaning for body: {self.body}",
                        f"leave it out or set body: {body}",
                        (name,),
                    )
        if self.at is not None and self.every is not None:
            raise Problem("conflicts with at", "give one of them", ("every",))
        wanted: list[Any] = [self.plane, self.box, self.shells, self.points]
        wanted += [self.surface, self.streamlines, self.tracers]
        if all(entry is None for entry in wanted):
            raise Problem("asks for nothing", "such as `plane: {}`")
