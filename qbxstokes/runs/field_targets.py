"""Points at which a field is wanted: grids by formula, piece by piece, and lists from files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from qbxstokes.case.field import Box, FieldSection, Plane, Points, Shells
from qbxstokes.case.load import LoadedCase
from qbxstokes.geometry.shape import Revolution
from qbxstokes.simulation.from_case import end_of
from qbxstokes.simulation.simulation import Simulation
from qbxstokes.tables import TableError, read_table
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.flow_around import Instant


@dataclass(frozen=True)
class Targets:
    """A set of points: its name, frame, shape of the grid (n,) to (n1, n2, n3), and points.

    points(begin, end) gives the points (end - begin, 3) in the frame of the set, last index of the
    grid fastest. parameters: what describes the grid in the result. body: whose frame it is, of
    several.
    """

    name: str
    frame: str
    shape: tuple[int, ...]
    points: Callable[[int, int], Array]
    parameters: dict[str, Array]
    body: int | None = None

    @property
    def size(self) -> int:
        """Number of points."""
        return int(np.prod(self.shape))

    def in_space(self, begin: int, end: int, position: Array, rotation: Array) -> Array:
        """Points (end - begin, 3) in space, see `in_space`."""
        if self.body is not None:
            position, rotation = position[self.body], rotation[self.body]
        return in_space(self.points(begin, end), self.frame, position, rotation)


def in_space(points: Array, frame: str, position: Array, rotation: Array) -> Array:
    """Points (N, 3) of a frame in space, for a body at the position with the rotation (3, 3)."""
    if frame == "space":
        return points
    return (points @ rotation.T if frame == "body" else points) + position


def targets_of(loaded: LoadedCase, section: FieldSection) -> list[Targets]:
    """The sets of points that the section asks for; raises CaseError for a bad file."""
    found = []
    if section.plane is not None:
        found.append(plane_targets(section.plane))
    if section.box is not None:
        found.append(_box(section.box))
    if section.shells is not None:
        several = loaded.case.bodies is not None
        for number, body in enumerate(loaded.case.members if several else [loaded.case.body]):
            of = number if several else None
            found.append(_shells(section.shells, body.outline, getattr(body, "size", 1.0), of))
    if section.points is not None:
        found.append(_listed(loaded, section.points))
    return found


def instant_of(section: FieldSection, start: Simulation) -> Instant:
    """The body where it starts, free or moving as the section says; the bodies, if several."""
    from qbxstokes.simulation.flow_around import Instant

    given = section.body != "free"
    return Instant(
        0.0,
        start.shaped(start.position),
        start.shaped(start.quaternion),
        np.array(section.velocity) if given else None,
        np.array(section.angular_velocity) if given else None,
        np.array(section.force),
        np.array(section.torque),
    )


def chosen_instants(loaded: LoadedCase, times: Array) -> list[int]:
    """Indices of the stored instants at which a motion wants its field; raises CaseError.

    What lies beyond the end of a motion that an event ended is left out.
    """
    section = loaded.case.field
    if section.every is not None:
        return list(range(0, len(times), section.every))
    if section.at is None:
        return [len(times) - 1]
    found = []
    early = times[-1] < end_of(loaded)
    for number, instant in enumerate(section.at):
        if early and instant > times[-1]:
            continue
        index = int(np.abs(times - instant).argmin())
        if abs(times[index] - instant) > 1e-9 * max(1.0, abs(times[-1])):
            raise loaded.error(
                ("field", "at", number),
                f"{instant:g} is not a stored instant",
                f"the nearest one is {times[index]:.17g}; time.at stores any",
            )
        found.append(index)
    return found or [len(times) - 1]


def plane_targets(plane: Plane) -> Targets:
    """Points of a plane, the second coordinate fastest."""
    first = np.array(plane.first) / np.linalg.norm(plane.first)
    second = np.array(plane.second) - first * (first @ plane.second)
    second /= np.linalg.norm(second)
    origin = np.array(plane.origin)
    a = np.linspace(plane.extent[0], plane.extent[1], plane.shape[0])
    b = np.linspace(plane.extent[2], plane.extent[3], plane.shape[1])

    def points(begin: int, end: int) -> Array:
        i, j = np.unravel_index(np.arange(begin, end), plane.shape)
        return origin + a[i][:, None] * first + b[j][:, None] * second

    parameters = {
        "first_coordinate": a,
        "second_coordinate": b,
        "origin": origin,
        "first": first,
        "second": second,
    }
    return Targets("plane", plane.frame, plane.shape, points, parameters)


def _box(box: Box) -> Targets:
    axes = [np.linspace(*ends) for ends in zip(box.lower, box.upper, box.shape, strict=True)]

    def points(begin: int, end: int) -> Array:
        index = np.unravel_index(np.arange(begin, end), box.shape)
        return np.stack([axis[i] for axis, i in zip(axes, index, strict=True)], axis=-1)

    names = ("x1", "x2", "x3")
    return Targets("box", box.frame, box.shape, points, dict(zip(names, axes, strict=True)))


def surface_angles(shape: tuple[int, int]) -> tuple[Array, Array]:
    """Polar angles from pole to pole and azimuths once around, without the last."""
    n_theta, n_phi = shape
    theta = np.linspace(0.0, np.pi, n_theta) if n_theta > 1 else np.array([0.5 * np.pi])
    return theta, 2.0 * np.pi * np.arange(n_phi) / n_phi


def _shells(shells: Shells, shape: Revolution, length: float, body: int | None) -> Targets:
    theta, phi = surface_angles(shells.shape)
    distances = np.array(shells.distances)
    size = (len(distances), *shells.shape)

    def points(begin: int, end: int) -> Array:
        d, i, j = np.unravel_index(np.arange(begin, end), size)
        foot, normal = shape.surface(theta[i], phi[j]), shape.normal(theta[i], phi[j])
        return length * foot + distances[d][:, None] * normal

    parameters = {"distance": distances, "theta": theta, "phi": phi}
    name = "shells" if body is None else f"shells_{body + 1}"
    return Targets(name, "body", size, points, parameters, body)


def _listed(loaded: LoadedCase, section: Points) -> Targets:
    path = loaded.path.parent / section.file
    key = ("field", "points", "file")
    try:
        points = read_table(path, columns=3).numbers  # a mapped list may be larger than memory
    except TableError as error:
        right = "three numbers a line, or an NPY array (N, 3)"
        raise loaded.error(key, str(error), right) from None
    return Targets(
        "points",
        section.frame,
        (len(points),),
        lambda begin, end: np.asarray(points[begin:end], dtype=float),
        {},
    )
