"""What the studies of motion share: starts on Jeffery orbits, averages with their uncertainty."""

import math
from functools import lru_cache
from typing import Any

import heavy
import numpy as np
from common import labelled, markdown

import qbxstokes as qs
from qbxstokes.geometry import rotation
from qbxstokes.reference import jeffery

Array = Any

# Tolerances of the two motions that every average is taken from.
LOOSE, TIGHT = 3e-8, 1e-9
# Of the slowest relaxation, these many times are discarded.
TRANSIENT = 25.0
SHEAR = qs.flow("shear", rate=1.0)
# Samples in one turn of a sphere; thin bodies flip faster, in a time of about min(k, 1/k).
_SAMPLES = 24
# Decimals in print where an uncertainty would allow more.
_DECIMALS = 7

# A body without inertia; the others of this shape share its hydrodynamics.
_massless = lru_cache(qs.Body)


def body(k, stokes_number=0.0, inertia="both"):
    """A body, whose integral equation is solved once for all Stokes numbers."""
    return _massless(k).with_inertia(stokes_number, inertia)


def paraboloid(distance):
    """u = K (x2^2 + x3^2) e1 of shear rate 1 at the distance from its axis: K = 1/(2 distance)."""
    return qs.flow("paraboloid", curvature=0.5 / distance)


def axes(directions):
    """Quaternions (n, 4) with the axis along each of the directions (n, 3).

    In the plane of shear q0 = q1 and q2 = q3, which the motion keeps to the last bit: a body that
    tumbles there stays there even where tumbling is unstable.
    """
    axis = np.array(list(directions), dtype=float)
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    half = 0.5 * np.arctan2(axis[:, 0], -axis[:, 1])
    c, s = np.cos(half), np.sin(half)
    plane = np.stack([c, c, s, s], axis=-1) * math.sqrt(0.5)
    return np.where(axis[:, 2:] == 0.0, plane, rotation.from_axis(axis))


def orbit(k, constants, phase=0.0):
    """Quaternions (n, 4) on the Jeffery orbits of the given constants; infinite is tumbling."""
    c = np.atleast_1d(np.asarray(constants, dtype=float))
    part, upright = np.where(np.isinf(c), 1.0, c), np.where(np.isinf(c), 0.0, 1.0)
    return axes(np.stack([part * np.cos(phase), -k * part * np.sin(phase), upright], axis=-1))


def averages(
    moving, flow, orientation, half_turns, position=(0.0, 0.0, 0.0), relaxed=None, half_turn=None
):
    """Averages (lanes,) over whole half-turns after the transient, each with its uncertainty.

    half_turns, rotation_rate, orbit_drift (rate of ln C), velocity (lanes, 3), position (lanes, 3;
    mean of the samples). The uncertainty is the larger of the change from tolerance LOOSE to TIGHT
    and half the difference between both halves of the time. relaxed: time that the transient takes,
    if it is not that of the slowest relaxation. half_turn: that of the slowest body, if it is not
    the one of tumbling.
    """
    k, stokes = moving.shape.aspect_ratio, moving.stokes_number
    rate = float(np.linalg.norm(flow.gradient(position)))
    if half_turn is None:  # of the lightest; all turn as Jeffery says without inertia of rotation
        half_turn = 0.5 * jeffery.period(k, rate)
        if moving.inertia != "translation":
            half_turn = heavy.tumbling(k, float(stokes.min()) * rate).half_turn / rate
    if relaxed is None:
        relaxed = TRANSIENT * float(stokes.max()) / min(heavy.relaxation_rates(k))
    step = min(2.0 * math.pi / _SAMPLES, 0.6 * max(min(k, 1.0 / k), 0.02)) / rate
    samples = math.ceil((half_turns + 0.5) * half_turn / step)
    times = relaxed + half_turn + step * np.arange(samples)
    middle, end = times[(samples - 1) // 2], times[-1]

    def over(motion, start, stop):
        part = motion.between(start, stop)
        found = part.averages() | {"position": part.position.mean(axis=1)}
        found["velocity"] = found["mean_velocity"]
        return found | {"rotation_rate": np.abs(found["rotation_rate"])}

    scene = {"position": position, "orientation": orientation}
    loose, tight = (
        qs.Simulation(moving, flow, **scene, tolerance=error).integrate(times)
        for error in (LOOSE, TIGHT)
    )
    whole, other = over(tight, times[0], end), over(loose, times[0], end)
    early, late = over(tight, times[0], middle), over(tight, middle, end)
    return {
        name: (
            whole[name],
            np.maximum(abs(whole[name] - other[name]), 0.5 * abs(late[name] - early[name])),
        )
        for name in ("half_turns", "rotation_rate", "orbit_drift", "velocity", "position")
    }


def groups(stokes_numbers, size):
    """Increasing Stokes numbers, to four digits, in groups that are integrated together."""
    rounded = [float(f"{st:.4g}") for st in stokes_numbers]
    return [rounded[i : i + size] for i in range(0, len(rounded), size)]


# -- in print -------------------------------------------------------------------------------------


def shown(value, error):
    """1.234(5)e-3 for (1.234 ± 0.005)e-3: one digit of the uncertainty, rounded up."""
    if value == 0.0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    places = _DECIMALS if error == 0.0 else exponent - math.floor(math.log10(error))
    places = min(max(places, 0), _DECIMALS)
    digit = math.ceil(error / 10.0 ** (exponent - places) - 1e-9)
    if digit == 10 and places > 0:
        places, digit = places - 1, 1
    if abs(round(value / 10.0**exponent, places)) >= 10.0:
        exponent, places = exponent + 1, places + 1
    return f"{value / 10.0**exponent:.{places}f}({max(digit, 1)})e{exponent}"


def cross(table, cell):
    """Print a table of Stokes numbers (down) and aspect ratios (across)."""
    ratios = np.unique(table["aspect_ratio"]).tolist()
    rows = []
    for st in np.unique(table["stokes_number"]).tolist():
        found = [table.where(aspect_ratio=k, stokes_number=st).rows for k in ratios]
        rows.append(
            [f"{float(f'{st:.3g}'):g}", *(cell(some[0]) if some else "–" for some in found)]
        )
    markdown(["St", *(f"k = {k:g}" for k in ratios)], rows)


def doubling(panel, y, log=""):
    """Distances from the axis of the flow on a logarithmic scale, as plain numbers."""
    places = (1, 2, 4, 8, 16, 32)
    labelled(panel, "distance from the axis of the flow ($c$)", y, "x" + log)
    panel.set_xticks(places, [str(place) for place in places])
    panel.tick_params(axis="x", which="minor", bottom=False, top=False)
