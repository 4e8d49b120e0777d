"""What the motion of one body over a wall takes from its table."""

from dataclasses import dataclass

from qbxstokes.typing import Array


@dataclass(frozen=True)
class WallConstants:
    """The arguments of `over_wall.rate` besides the state.

    load (6,): force and torque, in space. plane (3, 3): normal, point and velocity of the wall.
    ratio: k; size: the polar radius. terms (5, 3): of the flow. first: the first cell; cells and
    pieces: the table so far.
    """

    load: Array
    plane: Array
    ratio: float
    size: float
    terms: Array
    first: int
    cells: Array
    pieces: Array
