"""Section `rheology`: the history of the flow, Peclet numbers, orientations at the start."""

import math
from typing import Annotated, Any, Literal

import numpy as np

from qbxstokes.case.model import (
    NAME,
    VECTOR,
    Instants,
    Positive,
    Reader,
    Section,
    Tolerance,
    key,
    number,
    pointing,
    several,
    some,
    switch,
    whole,
)
from qbxstokes.case.sweep import Rule
from qbxstokes.case.values import Problem, describe, increasing, or_infinite

ISOTROPIC = "isotropic"


_MANY = some(number(or_infinite, gt=0))


def _numbers(value: Any) -> tuple[float, ...]:
    if isinstance(value, dict):
        if not {"linspace", "logspace"} & value.keys():
            right = "numbers, such as [0.1, 10, inf], or {logspace: [0.1, 100], count: 7}"
            raise Problem(f"is {describe(value)}", right)
        value = np.asarray(Rule.read(value).column(("peclet_number",)).values).tolist()
    return tuple(_MANY.read(value if isinstance(value, (list, tuple)) else [value]))


NUMBERS = Reader(_numbers, {"anyOf": [{"type": ["number", "string", "object"]}, _MANY.json]})
_FORMS: dict[str, Any] = {
    "aligned": pointing(VECTOR),
    "orbits": some(number(or_infinite, ge=0)),
    "table": NAME,
}


def _orientations(value: Any) -> Any:
    if value == ISOTROPIC:
        return value
    right = "isotropic, {aligned: [x1, x2, x3]}, {orbits: [C, ...]} or {table: FILE.csv}"
    if not isinstance(value, dict) or len(value) != 1 or next(iter(value)) not in _FORMS:
        raise Problem(f"is {describe(value)}", right)
    form, given = next(iter(value.items()))
    return {form: _FORMS[form].read(given)}


ORIENTATIONS = Reader(
    _orientations,
    {
        "anyOf": [
            {"enum": [ISOTROPIC]},
            {
                "type": "object",
                "properties": {name: reader.json for name, reader in _FORMS.items()},
                "additionalProperties": False,
                "minProperties": 1,
                "maxProperties": 1,
            },
        ]
    },
)


class LangevinSection(Section):
    """Brownian axes followed one by one, in the place of their density."""

    trajectories: Annotated[int, whole(ge=2, le=10**9)] = key("how many axes", 4096)
    strain: Positive = key(
        "over which a steady state is averaged, after three relaxation times 1/(6 D) or a fifth",
        50.0,
    )
    step: Positive | None = key(
        "longest step in units of 1/rate; unset: 0.05, or what diffusion or a cycle allows",
        None,
        0.02,
    )
    seed: Annotated[int, whole(ge=0, lt=2**63)] = key("of the random numbers", 0)
    paths: Annotated[int, whole(ge=0)] = key("axes that are kept whole, at the instants", 0)
    translation: bool = key(
        "diffuse as well, and tell the mean square displacement (protocol: startup)", False
    )


class RheologySection(Section):
    """A dilute suspension of the body in a homogeneous flow."""

    protocol: Literal["steady", "startup", "cessation", "oscillation"] = key(
        "history of the flow: steady, from rest, stopped after steady, or back and forth", "steady"
    )
    peclet_number: Annotated[tuple[float, ...], NUMBERS] = key(
        "rate of the flow, sqrt(2 E:E), over rotary diffusivity: numbers, or inf, or {linspace | "
        "logspace: [a, b], count: n}",
        (10.0,),
    )
    amplitude: Positive | None = key(
        "strain amplitude of an oscillation; its product with the frequency is the rate", None, 2.0
    )
    frequency: Positive | None = key(
        "angular frequency of an oscillation, in place of its amplitude", None, 0.5
    )
    times: Instants | None = key(
        "instants of a transient in units of 1/rate; unset: 201 to 20, or over a cycle",
        None,
        [0.0, 1.0, 10.0],
    )
    orientations: Annotated[Any, ORIENTATIONS] = key(
        "at the start, which without Brownian motion stay remembered: isotropic, "
        "{aligned: [x1, x2, x3]}, {orbits: [C, ...]} or {table: FILE.csv} of x1, x2, x3, weight",
        ISOTROPIC,
    )
    settling: Positive = key(
        "strain that a body with inertia is given to come to its attractor", 400.0
    )
    tolerance: Tolerance = key("relative error of the stress to aim at", 1e-8)
    distribution: Annotated[tuple[int, int], several(whole(ge=3, le=4096), "[n_theta, n_phi]")] = (
        key("numbers of angles at which densities of orientations are stored", (91, 180))
    )
    samples: Annotated[int, whole(ge=0, le=10**7)] = key(
        "axes to draw from each density, such as starts of an ensemble", 0
    )
    seed: Annotated[int, whole(ge=0, lt=2**63)] = key("of the axes that are drawn", 0)
    langevin: Annotated[LangevinSection | None, switch(LangevinSection)] = key(
        "follow single axes with random turns, whose means have standard errors", None, True
    )
    tables: bool = key("also write the densities as CSV files of theta, phi, density", False)

    def _check(self) -> None:
        given = [n for n in ("amplitude", "frequency") if getattr(self, n) is not None]
        if self.protocol == "oscillation" and len(given) != 1:
            wrong = "gives amplitude and frequency" if given else "is missing"
            right = "give one of amplitude and frequency: their product is the flow's rate"
            raise Problem(wrong, right, () if given else ("amplitude",))
        if self.protocol != "oscillation" and given:
            wrong = f"has no meaning for protocol: {self.protocol}"
            raise Problem(wrong, "leave it out", (given[0],))
        if self.times is not None:
            if self.protocol == "steady":
                raise Problem("have no meaning for protocol: steady", "leave them out", ("times",))
            if self.times[0] < 0:
                raise Problem("is before the start", "instants from 0 on", ("times", 0))
            increasing(self.times, "times")
        finite = [math.isfinite(number) for number in self.peclet_number]
        if self.langevin is not None:
            self._check_langevin(self.langevin, all(finite))
        elif self.orientations != ISOTROPIC and any(finite):
            wrong = "are forgotten by Brownian motion"
            raise Problem(wrong, "peclet_number: inf, or isotropic", ("orientations",))

    def _check_langevin(self, given: LangevinSection, finite: bool) -> None:
        if not finite:
            wrong = "is infinite: nothing is random without Brownian motion"
            raise Problem(wrong, "finite numbers, or no langevin", ("peclet_number",))
        if given.paths > given.trajectories:
            wrong = f"is more than the {given.trajectories} trajectories"
            raise Problem(wrong, "at most as many", ("langevin", "paths"))
        startup, steady = self.protocol == "startup", self.protocol == "steady"
        meant = {
            ("orientations",): self.orientations == ISOTROPIC or startup,
            ("langevin", "translation"): not given.translation or startup,
            ("langevin", "paths"): not given.paths or not steady,
            ("samples",): not self.samples,
            ("tables",): not self.tables,
        }
        for path, good in meant.items():
            if not good:
                wrong = f"has no meaning for langevin and protocol: {self.protocol}"
                raise Problem(wrong, "leave it out", path)
