"""Sections of a run: time, accuracy, events, checkpoint, output; random turns and statistics."""

import re
from typing import Annotated, Any, Literal, NamedTuple

from qbxstokes.case.model import (
    NAME,
    Direction,
    Instants,
    NotNegative,
    Positive,
    Reader,
    Section,
    Share,
    Tolerance,
    choice,
    key,
    maybe,
    number,
    refined,
    several,
    some,
    whole,
)
from qbxstokes.case.values import Problem, describe, increasing, to_number
from qbxstokes.quantities import RECORDABLE


class Time(Section):
    """End (or periods), stored instants and tolerance of the time integration."""

    end: Positive | None = key("end of the motion, in time units", None, 50.0)
    periods: Positive | None = key(
        "end of the motion in Jeffery periods of the flow's gradient at the start", None, 3
    )
    samples: Annotated[int, whole(ge=2, le=10_000_000)] | None = key(
        "number of equally spaced instants stored, ends included; unset: 201, or more where the "
        "axis would turn more than 0.3 rad between them (up to 20001)",
        None,
        301,
    )
    at: Instants | None = key(
        "instants to store, increasing; replaces end, periods and samples", None, [0.0, 0.5, 2.0]
    )
    tolerance: Tolerance = key(
        "error control of the time integration, relative and absolute", 1e-10
    )

    def _check(self) -> None:
        given = [name for name in ("end", "periods", "at") if getattr(self, name) is not None]
        if len(given) != 1:
            wrong = f"gives {' and '.join(given)}" if given else "does not say when to end"
            raise Problem(wrong, "give exactly one of end, periods, at")
        if self.at is None:
            return
        if "samples" in self.given_keys:
            raise Problem("conflicts with at", "give one of them", ("samples",))
        if self.at[0] < 0:
            raise Problem("is before the start", "instants from 0 on", ("at", 0))
        if self.at[-1] == 0:
            raise Problem("has no instant after 0", "at least one positive instant", ("at",))
        increasing(self.at, "at")


UNIFORM_KEYS = ("r_over_h", "upsampling", "coefficients")
GRADED_KEYS = ("radius_factor", "panel_order", "panel_ratio")


class Hydrodynamics(Section):
    """Accuracy and scheme of the boundary integral equation."""

    tolerance: Tolerance = key("relative error of velocities, force and torque to aim at", 1e-10)
    scheme: Literal["graded", "uniform"] = key(
        "quadrature: panels graded to each centre, or uniform upsampling", "graded"
    )
    n_theta: Annotated[int, whole(ge=4, le=4096)] | None = key(
        "Gauss-Legendre nodes in the polar angle; unset: from tolerance", None, 12
    )
    n_phi: Annotated[int, whole(ge=4, le=8192)] | None = key(
        "trapezoid nodes in the azimuth; unset: from tolerance", None, 16
    )
    expansion_order: Annotated[int, whole(ge=0, le=200)] | None = key(
        "order p of the expansions; unset: from tolerance", None, 10
    )
    radius_factor: Share | None = key(
        "expansion radius over the least local radius (graded); unset: from tolerance", None, 0.3
    )
    panel_order: Annotated[int, whole(ge=2, le=64)] | None = key(
        "Gauss nodes per side of a panel (graded); unset: from tolerance", None, 12
    )
    panel_ratio: Annotated[float, number(gt=0, le=4)] | None = key(
        "panel length over distance to the centre (graded), at most", None, 0.7
    )
    r_over_h: Positive | None = key(
        "radius over spacing: r = 2 pi (r/h) / n_theta (uniform)", None, 0.48
    )
    upsampling: Annotated[int, whole(ge=1, le=200)] | None = key(
        "upsampling factor of both directions (uniform)", None, 16
    )
    coefficients: bool | None = key(
        "sum spherical-harmonic coefficients (uniform); unset: an equal form, faster", None, True
    )
    expansion: Literal["average", "inner", "outer"] | None = key(
        "side of expansions, or mean of both; unset: inner (graded), average (uniform)",
        None,
        "inner",
    )
    completion: Literal["surface", "point"] | None = key(
        "flow that carries force and torque, spread or at the centre; unset: surface, but no "
        "resistance is formed where no force acts",
        None,
    )
    solve: Literal["functional", "every_step"] = key(
        "free motion from functionals formed once, or by a solve at every step", "functional"
    )
    derivatives: Annotated[int, whole(ge=1, le=2)] | None = key(
        "degree of the flow's derivatives at the centre that move the body, for one much smaller "
        "than the flow's scale: what that neglects is told; unset: the flow on the whole surface",
        None,
    )
    gmres_tolerance: Share | None = key(
        "relative residual of GMRES; unset: from tolerance", None, 1e-12
    )
    preconditioner: bool = key("mode-wise preconditioner for GMRES", True)
    cache: str | None = key(
        "folder that keeps operators between runs; unset: in the user's cache", None, "operators"
    )

    def _check(self) -> None:
        graded = self.scheme == "graded"
        for name in UNIFORM_KEYS if graded else GRADED_KEYS:
            if getattr(self, name) is not None:
                other = "uniform" if graded else "graded"
                wrong = f"has no meaning for scheme: {self.scheme}"
                raise Problem(wrong, f"leave it out or set scheme: {other}", (name,))
        for name in ("n_theta", "n_phi", "expansion_order", "r_over_h", "upsampling"):
            if not graded and getattr(self, name) is None:
                raise Problem("is missing", "scheme: uniform needs it explicitly", (name,))


CORNER = several(maybe(number()), "[x1, x2, x3] or null")
TURNING = several(choice("x1", "x2", "x3", "d1", "d2", "d3"))


class Region(Section):
    """A box in space with sides along the axes; the run ends where the centre leaves it."""

    lower: Annotated[tuple[float | None, ...], CORNER] = key(
        "lower bounds of x1, x2, x3; null for none", (None,) * 3, [-10.0, None, None]
    )
    upper: Annotated[tuple[float | None, ...], CORNER] = key(
        "upper bounds of x1, x2, x3; null for none", (None,) * 3, [10.0, None, None]
    )

    def _check(self) -> None:
        for index, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if low is not None and high is not None and low >= high:
                raise Problem(f"{high:g} is not above {low:g}", "a larger bound", ("upper", index))


class Events(Section):
    """Half-turns, turning points, rest, the edge of a region, and singular points of the flow."""

    half_turns: bool = key(
        "record passages of the axis through a plane: period, orbit constant, drift", True
    )
    plane: Direction | None = key(
        "normal of that plane; unset: stream (prolate) or gradient (oblate)", None, [1.0, 0.0, 0.0]
    )
    turning_points: Annotated[tuple[str, ...], TURNING] = key(
        "record where these of x1, x2, x3 (centre), d1, d2, d3 (axis) turn back", (), ["x1", "d3"]
    )
    steady: Positive | None = key(
        "record when axis and velocity change by less than this per unit of time", None, 1e-6
    )
    stop_when_steady: bool = key("end the run at that instant", False)
    region: Region | None = key("end the run where the centre leaves", None)
    clearance: NotNegative | None = key(
        "end the run where a singular point of the flow is so near to the surface (c); "
        "unset: 0.05, or half of what there is at the start",
        None,
        0.05,
    )

    def _check(self) -> None:
        if self.stop_when_steady and self.steady is None:
            raise Problem("needs steady", "a rate such as steady: 1e-6", ("stop_when_steady",))


_EVERY = re.compile(r"(?P<number>.*?)\s*(?P<unit>s|seconds?|steps?|periods?)\Z", re.DOTALL)


class Interval(NamedTuple):
    """A number of seconds of wall time, steps, or Jeffery periods."""

    number: float
    unit: str


def _every(value: Any) -> str:
    match = _EVERY.match(value.strip()) if isinstance(value, str) else None
    text, word = match.groups() if match else (value, "s")
    unit = {"st": "steps", "pe": "periods"}.get(word[:2], "seconds")
    try:
        number = to_number(text)
    except Problem:
        right = "such as 60 s, 10000 steps or 100 periods"
        raise Problem(f"{describe(value)} is no interval", right) from None
    if number <= 0 or (unit == "steps" and number < 1):
        raise Problem(f"is {describe(value)}", "more than nothing, such as 60 s")
    return f"{number:.12g} {unit}"


EVERY = Reader(_every, {"anyOf": [{"type": "string"}, {"type": "number"}]})


class Checkpoints(Section):
    """A run that is stopped goes on from its last checkpoint with --resume."""

    every: Annotated[str, EVERY] = key(
        "between checkpoints: 60 s of wall time, 10000 steps or 100 periods", "30 seconds", "60 s"
    )

    @property
    def interval(self) -> Interval:
        """The interval as number and unit."""
        number, unit = self.every.split()
        return Interval(float(number), unit)


FILE = refined(NAME, lambda name: not name.endswith("/"), "a file name", "names a directory")


class Output(Section):
    """The result file."""

    file: Annotated[str, FILE] | None = key(
        "result file, in the working directory; unset: the case's name + .h5", None, "result.h5"
    )
    overwrite: bool = key("replace an existing result; otherwise a free name is numbered", False)
    fields: Annotated[tuple[str, ...], some(choice(*RECORDABLE))] | None = key(
        "quantities to store besides time; unset: all but stresses", None, ["position", "axis"]
    )
    merge: bool = key(
        "copy the parts of a sweep into one file; false: they stay in FILE.parts, which the result "
        "shows as one (HDF5 virtual datasets): half the disk",
        True,
    )


class Compare(Section):
    """Comparison with a closed form or a semi-analytic reference at the end of the run."""

    reference: Literal["auto", "none"] = key(
        "compare with a closed form where one is known, or not at all", "auto"
    )
    tolerance: Positive | None = key(
        "largest error allowed, above it the run fails (exit 1); unset: no limit", None, 1e-8
    )


class Brownian(Section):
    """Rotary and translational diffusion of bodies without inertia, in sweeps."""

    rotary_diffusivity: Positive = key("of the axis, in 1/time", example=0.1)
    translation: bool = key(
        "displace the bodies as well, by their own mobility (in sweeps of motions)", False
    )
    step: Positive | None = key(
        "longest time from one random turn to the next; unset: 0.05 over the flow's rate or the "
        "diffusivity. With store: statistics it is the spacing of the series",
        None,
        0.02,
    )
    seed: Annotated[int, whole(ge=0, lt=2**63)] = key("of the random numbers", 0)


RATES = ("tumbling", "spinning", "cos_vorticity")
STRAINS = ("cos_strain_1", "cos_strain_2", "cos_strain_3")


class Statistics(Section):
    """Moments, distributions, means in time and correlations of axes along paths.

    tumbling and spinning are squares of rates, |dp/dt|^2 and (Omega.p)^2; cos_vorticity and
    cos_strain_1 (most stretching) to 3 are |cos| of the angle of the axis p with these directions.
    """

    quantities: Annotated[tuple[str, ...], some(choice(*RATES, *STRAINS))] = key(
        "what is looked at: " + ", ".join((*RATES, *STRAINS)), RATES
    )
    stresses: bool = key(
        "mean stress of the particles, its Brownian part, and the viscosity it makes", False
    )
    every: Annotated[int, whole(ge=1)] = key("samples from one look to the next", 1)
    discard: Annotated[float, number(ge=0, lt=1)] = key(
        "part of the time left out, from the start", 0.0
    )
    bins: Annotated[int, whole(ge=2, le=100_000)] = key("of each distribution", 200)
    correlation: Annotated[int, whole(ge=0, le=1000)] = key(
        "lags of the axis's correlation, spaced in equal proportion", 32
    )
    keep: Annotated[int, whole(ge=0, le=256)] = key(
        "paths, the first ones, whose axes are stored at every look", 0
    )
    seed: Annotated[int, whole(ge=0)] = key("of axes at random", 0)
    sampling: bool = key(
        "also follow the first paths on every other sample, to tell what the sampling leaves", True
    )
