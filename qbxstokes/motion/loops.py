"""Loops of the equations of motion over the lanes of a block, to be compiled (compiled.py).

y and dydt: (n_state, n_lanes). flow and body: what `pack_flow` and `pack_body` give, one column
for all lanes, (m,), or one for each, (m, n_lanes), of which the last rows may be missing where the
degree needs none of them. loads: (12, n_lanes) or None. rates: (4, n_lanes), None for massless
bodies. jacobian: (n_lanes, n_state, n_state). follow: as in `inertial`. still: None, or centres
(3, n_lanes) that stay at rest; y and dydt then hold q, and W, alone.

The lanes pass through tiles of fixed size, whose rows the compiler knows not to overlap: it then
works on several lanes at once. It may not reorder arithmetic, so that the numbers are those of the
plain functions. What all lanes share is read before the loop; the compiler leaves out the branches
on `ndim` and None.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

# Those of one class of laws stand for all: compiled.py puts in those of the class at hand.
from qbxstokes.motion.fore_aft import N_NUMBERS, inertial, massless, unpack_body
from qbxstokes.motion.layout import N_INERTIAL, ORIENTATION, SPIN
from qbxstokes.motion.taylor import N_FLOW, STEP, six, three, unpack_flow
from qbxstokes.typing import Array

TILE = 64
# Where the parts of a state begin.
_Q, _W = ORIENTATION.start, SPIN.start
_N_Q = ORIENTATION.stop - ORIENTATION.start


@dataclass(frozen=True)
class BlockConstants:
    """What the compiled loop over a block needs besides the states, see the module's text.

    kernels: the class of the law. rates and follow are of inertial bodies alone. changing: the rows
    of the flow that change in time (`flow_rows`), None for steady flows.
    """

    kernels: Any
    degree: int
    flow: Array
    body: Array
    loads: Array | None
    rates: Array | None
    follow: tuple[float, float] | None
    still: Array | None = None
    changing: Any = None


def copy_tile(source: Any, start: int, tile: Any, count: int) -> None:
    """Columns start to start + count of an array into a tile."""
    for i in range(source.shape[0]):
        for b in range(count):
            tile[i, b] = source[i, start + b]


def copy_back(tile: Any, target: Any, start: int, count: int) -> None:
    """A tile into columns start to start + count of an array."""
    for i in range(target.shape[0]):
        for b in range(count):
            target[i, start + b] = tile[i, b]


def copy_constants(
    start: int,
    count: int,
    flow: Any,
    u: Any,
    body: Any,
    v: Any,
    loads: Any,
    f: Any,
    rates: Any,
    p: Any,
) -> None:
    """What differs from lane to lane into the tiles u, v, f and p."""
    if flow.ndim == 2:
        copy_tile(flow, start, u, count)
    if body.ndim == 2:
        copy_tile(body, start, v, count)
    if loads is not None:
        copy_tile(loads, start, f, count)
    if rates is not None:
        copy_tile(rates, start, p, count)


def column(s: Any, b: int) -> Any:
    """The state of lane b, of which a massless body reads the first part."""
    return six(s[:, b], 0) + six(s[:, b], 6) + (s[12, b],)


def moved_column(s: Any, b: int, j: int) -> Any:
    """The same with a complex step of number j."""
    return (
        complex(s[0, b], STEP if j == 0 else 0.0),
        complex(s[1, b], STEP if j == 1 else 0.0),
        complex(s[2, b], STEP if j == 2 else 0.0),
        complex(s[3, b], STEP if j == 3 else 0.0),
        complex(s[4, b], STEP if j == 4 else 0.0),
        complex(s[5, b], STEP if j == 5 else 0.0),
        complex(s[6, b], STEP if j == 6 else 0.0),
        complex(s[7, b], STEP if j == 7 else 0.0),
        complex(s[8, b], STEP if j == 8 else 0.0),
        complex(s[9, b], STEP if j == 9 else 0.0),
        complex(s[10, b], STEP if j == 10 else 0.0),
        complex(s[11, b], STEP if j == 11 else 0.0),
        complex(s[12, b], STEP if j == 12 else 0.0),
    )


def loads_of_lane(loads: Any, f: Any, b: int) -> Any:
    """The loads of lane b from the tile f, or None."""
    return None if loads is None else six(f[:, b], 0) + six(f[:, b], 6)


def massless_lane(
    y: Any, flow: Any, body: Any, loads: Any, f: Any, rates: Any, p: Any, follow: Any, b: int
) -> Any:
    """dy/dt of lane b in the state y, with its loads from the tile f."""
    law, mobility, _ = body
    return massless(y, flow, law, mobility, loads_of_lane(loads, f, b))


def inertial_lane(
    y: Any, flow: Any, body: Any, loads: Any, f: Any, rates: Any, p: Any, follow: Any, b: int
) -> Any:
    """The same of a body with inertia, with its rates from the tile p."""
    law, mobility, gyration = body
    relaxation = p[0, b], p[1, b], p[2, b], p[3, b]
    push = loads_of_lane(loads, f, b)
    return inertial(y, flow, law, mobility, push, relaxation, gyration, follow)


rate_of_lane = inertial_lane  # compiled.py puts in that of the bodies at hand


def rate_block(
    y: Any, dydt: Any, flow: Any, body: Any, loads: Any, rates: Any, follow: Any, still: Any
) -> None:
    """dy/dt of every lane of a block."""
    s, r = np.zeros((N_INERTIAL, TILE)), np.empty((N_INERTIAL, TILE))
    f, p = np.empty((12, TILE)), np.empty((4, TILE))
    u = np.empty((N_FLOW, TILE)) if flow.ndim == 2 else s
    v = np.empty((N_NUMBERS, TILE)) if body.ndim == 2 else s
    one_flow = unpack_flow(flow if flow.ndim == 1 else u[:, 0])
    one_body = unpack_body(body if body.ndim == 1 else v[:, 0])
    for start in range(0, y.shape[1], TILE):
        count = min(TILE, y.shape[1] - start)
        copy_constants(start, count, flow, u, body, v, loads, f, rates, p)
        if still is None:
            copy_tile(y, start, s, count)
        else:
            copy_tile(still, start, s, count)
            copy_tile(y[:_N_Q], start, s[_Q:], count)
            copy_tile(y[_N_Q:], start, s[_W:], count)
        for b in range(count):
            lane_flow = one_flow if flow.ndim == 1 else unpack_flow(u[:, b])
            lane_body = one_body if body.ndim == 1 else unpack_body(v[:, b])
            state = column(s, b)
            rate = rate_of_lane(state, lane_flow, lane_body, loads, f, rates, p, follow, b)
            for i in range(len(rate)):
                r[i, b] = rate[i]
        if still is None:
            copy_back(r, dydt, start, count)
        else:
            copy_back(r[_Q:], dydt[:_N_Q], start, count)
            copy_back(r[_W:], dydt[_N_Q:], start, count)


def massless_state(s: Any, still: Any) -> Any:
    """The state of the only lane from its numbers s, or from those that change."""
    if still is None:
        return three(s, 0) + three(s, 3) + (s[6],)
    return three(still[:, 0], 0) + three(s, 0) + (s[3],)


def inertial_state(s: Any, still: Any) -> Any:
    """The same of a body with inertia."""
    if still is None:
        return six(s, 0) + six(s, 6) + (s[12],)
    return three(still[:, 0], 0) + three(s, 0) + (s[3], 0.0, 0.0, 0.0) + three(s, 4)


state_of_one = inertial_state  # as for `rate_of_lane`


def single_block(
    y: Any, dydt: Any, flow: Any, body: Any, loads: Any, rates: Any, follow: Any, still: Any
) -> None:
    """The same of a block of one lane: without tiles, which take longer than its rate."""
    state = state_of_one(y[:, 0], still)
    one_flow, one_body = unpack_flow(flow), unpack_body(body)
    rate = rate_of_lane(state, one_flow, one_body, loads, loads, rates, rates, follow, 0)
    if still is None:
        for i in range(len(rate)):
            dydt[i, 0] = rate[i]
    else:
        for i in range(_N_Q):
            dydt[i, 0] = rate[_Q + i]
        for i in range(_N_Q, len(dydt)):
            dydt[i, 0] = rate[_W - _N_Q + i]


def jacobian_block(
    y: Any, jacobian: Any, flow: Any, body: Any, loads: Any, rates: Any, follow: Any
) -> None:
    """d(dy/dt)/dy of every lane of a block, one complex step per column."""
    s, r = np.zeros((N_INERTIAL, TILE)), np.empty((N_INERTIAL, TILE))
    f, p = np.empty((12, TILE)), np.empty((4, TILE))
    u = np.empty((N_FLOW, TILE)) if flow.ndim == 2 else s
    v = np.empty((N_NUMBERS, TILE)) if body.ndim == 2 else s
    one_flow = unpack_flow(flow if flow.ndim == 1 else u[:, 0])
    one_body = unpack_body(body if body.ndim == 1 else v[:, 0])
    for start in range(0, y.shape[1], TILE):
        count = min(TILE, y.shape[1] - start)
        copy_constants(start, count, flow, u, body, v, loads, f, rates, p)
        copy_tile(y, start, s, count)
        for j in range(y.shape[0]):
            for b in range(count):
                lane_flow = one_flow if flow.ndim == 1 else unpack_flow(u[:, b])
                lane_body = one_body if body.ndim == 1 else unpack_body(v[:, b])
                state = moved_column(s, b, j)
                rate = rate_of_lane(state, lane_flow, lane_body, loads, f, rates, p, follow, b)
                for i in range(len(rate)):
                    r[i, b] = rate[i].imag / STEP
            for i in range(y.shape[0]):
                for b in range(count):
                    jacobian[start + b, i, j] = r[i, b]
