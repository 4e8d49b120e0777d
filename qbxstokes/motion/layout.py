"""The state of a rigid body, and how the states of many lie in memory.

State of a body: the position of its centre of mass x (space frame), the quaternion q that turns its
frame to that of space, and for St > 0 the velocity V of the centre of mass (space) and the angular
velocity W (body frame): 7 or 13 numbers, in this order.

Lanes are independent copies that are integrated together; the bodies of a lane share one fluid.
Arrays of states are (n_state, columns) for the kernels and (columns, n_state) for the user, with a
column for every body of every lane, lane fastest: column body * lanes + lane.
"""

from collections.abc import Callable
from dataclasses import dataclass

from qbxstokes.typing import Array

# Parts of a state.
POSITION = slice(0, 3)
ORIENTATION = slice(3, 7)
VELOCITY = slice(7, 10)
SPIN = slice(10, 13)
RATES = slice(7, 13)  # velocity and spin
# Parts of a motion (U, Omega).
TRANSLATION = slice(0, 3)
ROTATION = slice(3, 6)
# Numbers of a state for St = 0 and for St > 0.
N_MASSLESS = 7
N_INERTIAL = 13


@dataclass(frozen=True)
class Layout:
    """Lanes of some bodies each, with `n_state` numbers per body.

    A flat vector holds them by component, (n_state, columns), which is how the kernels sweep them,
    or by lane, (lanes, bodies, n_state), in which the Jacobian is one dense block for every lane.
    """

    n_state: int
    lanes: int
    bodies: int = 1

    @property
    def columns(self) -> int:
        """Bodies of all lanes."""
        return self.bodies * self.lanes

    @property
    def size(self) -> int:
        """Numbers of all states."""
        return self.columns * self.n_state

    @property
    def block(self) -> int:
        """Numbers of the states of one lane, which may depend on each other."""
        return self.bodies * self.n_state

    def by_component(self, values: Array) -> Array:
        """(n_state, columns) of a flat vector by component, as a view."""
        return values.reshape(self.n_state, self.columns)

    def by_lane(self, values: Array) -> Array:
        """(n_state, columns) of a flat vector by lane; a view for one body."""
        return self.states(values, True).T

    def states(self, values: Array, by_lane: bool) -> Array:
        """States (..., columns, n_state) of flat vectors (..., size), as a view where it may be."""
        lead = values.shape[:-1]
        if not by_lane:
            return values.reshape(*lead, self.n_state, self.columns).swapaxes(-1, -2)
        lanes = values.reshape(*lead, self.lanes, self.bodies, self.n_state)
        return lanes.swapaxes(-3, -2).reshape(*lead, self.columns, self.n_state)

    def flat_by_lane(self, states: Array) -> Array:
        """The flat vector by lane of states (columns, n_state)."""
        return states.reshape(self.bodies, self.lanes, self.n_state).swapaxes(0, 1).ravel()


@dataclass(frozen=True)
class Step:
    """An accepted step for an observer: instants before and after, states (columns, n_state).

    state: the state at any instant between, as accurate as the steps. costly: whether that takes
    about what a step takes.
    """

    before: float
    after: float
    start: Array
    end: Array
    state: Callable[[float], Array]
    costly: bool = False
