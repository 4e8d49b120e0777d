"""Physical units: the scales of length, time and viscosity, and what they make of quantities.

By pint, which is loaded only where a case or a reader asks for units.
"""

import math
import re
from collections.abc import Mapping
from functools import cache
from typing import Any

from qbxstokes.errors import SceneError, needed

# What a text of scales may be: numbers, c, tau, mu and their powers, products and quotients.
_TERM = re.compile(r"(?:c|tau|mu|\d+|[ ^/()*-])+")
# A number, or arithmetic, and a unit after it.
_WITH_UNIT = re.compile(r"\s*[-+.\d][-+.\deE*/() ]*\s*[A-Za-zµμ°%].*")

# Keys of `units`, what they are, and an example of each.
GIVEN = {
    "length": ("[length]", "10 um"),
    "rate": ("1/[time]", "5 1/s"),
    "time": ("[time]", "0.2 s"),
    "viscosity": ("[viscosity]", "1 mPa*s"),
    "body_density": ("[density]", "2650 kg/m^3"),
    "fluid_density": ("[density]", "1000 kg/m^3"),
    "gravity": ("[acceleration]", "9.81 m/s^2"),
}


@cache
def _registry() -> Any:
    return needed("pint", "a case or result with units").UnitRegistry()


# Arithmetic of whole numbers without end: towers and nests of powers, three digits above.
_ENDLESS = re.compile(r"(?:\*\*|\^)[-+\s\d.]*(?:\*\*|\^|\d{3})|\([^)]*\(")


def _quantity(text: str) -> Any:
    """What pint reads in a text; raises errors of many kinds for what is no quantity."""
    if len(text) > 100 or _ENDLESS.search(text):
        raise ValueError
    return _registry().parse_expression(text)


def has_unit(text: Any) -> bool:
    """Whether a text is a number with a unit, such as '3 um'; angles are none."""
    if not isinstance(text, str) or not _WITH_UNIT.fullmatch(text):
        return False
    unit = re.sub(r"^[-+.\deE*/() ]*", "", text)
    return ".py:" not in text and not re.fullmatch(r"deg(rees?)?|°|rad(ians?)?", unit)


class Scales:
    """Scales of length c, time tau and viscosity mu, from texts with units (`GIVEN`).

    length and one of rate and time are needed. Without a viscosity forces, torques and stresses
    have no scale. Raises SceneError by the key that is wrong, MissingPackageError without pint.
    """

    def __init__(self, given: Mapping[str, str]) -> None:
        self.given = {name: text for name, text in given.items() if text is not None}
        _registry()  # MissingPackageError is no wrong quantity
        self._held: dict[str, Any] = {}
        for name, text in self.given.items():
            kind, example = GIVEN[name]
            try:
                value = _quantity(str(text))
                right = value.check(kind) and 0.0 < value.magnitude < math.inf
            except Exception:
                right = False
            if not right:
                raise SceneError(f"units.{name}", f"is {text!r}", f"write one such as {example}")
            self._held[name] = value
        if ("rate" in self._held) == ("time" in self._held) or "length" not in self._held:
            missing = "length" if "length" not in self._held else "rate"
            wrong = "is missing" if missing not in self._held else "stands beside time"
            raise SceneError(f"units.{missing}", wrong, "length and one of rate, time are needed")
        self.length = self._held["length"]
        self.time = self._held["time"] if "time" in self._held else 1 / self._held["rate"]
        self.viscosity: Any = self._held.get("viscosity")

    def scale(self, units: str) -> Any:
        """The physical quantity that is 1 in units such as 'mu c^2/tau'; None where there is none.

        The scale of 1 and of rad is None as well: they are as they are.
        """
        if units in ("", "1", "rad", "s") or not _TERM.fullmatch(units):
            return None
        if "mu" in units and self.viscosity is None:
            return None
        written = re.sub(r"(?<=[\w)]) (?=[\w(])", "*", units.replace("^", "**"))
        return _registry().parse_expression(
            written, c=self.length, tau=self.time, mu=self.viscosity
        )

    def plain(self, text: str, units: str) -> float:
        """A text with a unit in units of this program, such as 'c/tau'; raises ValueError."""
        scale = self.scale(units)
        if scale is None:
            why = "needs units.viscosity" if "mu" in units else "takes no unit"
            raise ValueError(why)
        try:
            value = _quantity(text)
            if not value.check(scale.dimensionality):
                raise ValueError
        except Exception:
            unit = (self.shown(units) or "?")[1]
            raise ValueError(f"is no quantity in units such as {unit}") from None
        return float((value / scale).to("dimensionless").magnitude)

    def shown(self, units: str) -> tuple[float, str] | None:
        """The scale of units as a number and the physical unit that it is shown in; None as there.

        Lengths are in the unit of `units.length`, times in that of `units.time` or of the rate;
        forces in a unit that suits their scale, stresses in Pa.
        """
        if (scale := self.scale(units)) is None:
            return None
        registry, powers = _registry(), dict(scale.dimensionality)
        mass, length, time = (int(powers.get(f"[{d}]", 0)) for d in ("mass", "length", "time"))
        if (mass, length, time) == (1, -1, -2):
            unit = scale.to("Pa").to_compact().units
        elif (mass, length, time) == (1, -1, -1):
            unit = self.viscosity.units
        else:
            unit = registry.Unit("")
            if mass:
                force = (self.viscosity * self.length**2 / self.time).to("N").to_compact().units
                unit, length, time = force**mass, length - mass, time + 2 * mass
            for base, power in ((self.length.units, length), (self.time.units, time)):
                unit = unit * base**power if power else unit
        shown = scale.to(unit)
        return float(shown.magnitude), f"{shown.units:~C}".replace("**", "^")

    def table(self) -> dict[str, str]:
        """The scales that are known, as texts: length, time, velocity, force, ..."""
        found = {}
        for name, units in _NAMES.items():
            if (shown := self.shown(units)) is not None:
                found[name] = "{:.6g} {}".format(*shown)
        return found

    @property
    def numbers(self) -> dict[str, float]:
        """Stokes, Reynolds and gravity number, those that are known."""
        names = ("stokes_number", "reynolds_number", "gravity_number")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    @property
    def told(self) -> str:
        """The scales and the numbers that follow from them, in one line."""
        names = {"length": "c", "time": "tau", "viscosity": "mu"}
        parts = [f"{names[n]} = {text}" for n, text in self.table().items() if n in names]
        short = {"stokes_number": "St", "reynolds_number": "Re", "gravity_number": "G"}
        return ", ".join(parts + [f"{short[n]} = {v:.6g}" for n, v in self.numbers.items()])

    @property
    def remarks(self) -> list[str]:
        """What these scales make doubtful."""
        number = self.reynolds_number or 0.0
        wrong = f"Reynolds number {number:.6g} at the scale of the body"
        return [f"{wrong}: the inertia of the fluid is not in the equations"] * (number > 0.1)

    @property
    def stokes_number(self) -> float | None:
        """St = rho_b c^2/(mu tau); None without viscosity or density of the body."""
        return self._ratio("body_density")

    @property
    def reynolds_number(self) -> float | None:
        """Re = rho_f c^2/(mu tau), that of the flow at the scale of the body."""
        return self._ratio("fluid_density")

    def _ratio(self, density: str) -> float | None:
        if density not in self._held or self.viscosity is None:
            return None
        ratio = self._held[density] * self.length**2 / (self.viscosity * self.time)
        return float(ratio.to("dimensionless").magnitude)

    @property
    def gravity_number(self) -> float | None:
        """G = (rho_b - rho_f) g c tau/mu; None where one of these is not given."""
        held = self._held
        if self.viscosity is None or not {"body_density", "fluid_density", "gravity"} <= {*held}:
            return None
        excess = held["body_density"] - held["fluid_density"]
        number = excess * held["gravity"] * self.length * self.time / self.viscosity
        return float(number.to("dimensionless").magnitude)


_NAMES = {
    "length": "c",
    "time": "tau",
    "velocity": "c/tau",
    "viscosity": "mu",
    "force": "mu c^2/tau",
    "torque": "mu c^3/tau",
    "stress": "mu/tau",
}
