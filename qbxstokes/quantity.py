"""What is known of a quantity before it has a value, and lists of them written as tables."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

_XYZ = ("1", "2", "3")
_ANGLES, _ANGLE_SYMBOLS = ("phi", "theta", "psi"), (r"\varphi", r"\theta", r"\psi")
_PAIRS = ("11", "22", "33", "12", "13", "23")
# Components that many quantities have share an axis, so that products go by component.
_SHARED = {(): "component", _XYZ: "component", _PAIRS: "pair"}


@dataclass(frozen=True)
class Quantity:
    """What is known of a quantity before it has a value.

    shape: at one instant, at one point, or of one trajectory. components: what tells them apart in
    names such as position_1. parts: symbols of the components, where they are not the symbol with
    the component below. label: what stands at an axis, where it is not the name and the symbol.
    several: whether the shape begins with the bodies. lead: axes of a dataset before the shape, as
    many of them as it has.
    """

    name: str
    symbol: str
    units: str
    description: str
    frame: str = ""
    shape: tuple[int, ...] = ()
    components: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()
    label: str = ""
    several: bool = False
    lead: tuple[str, ...] = ()

    def axes(self, dimensions: int) -> tuple[str, ...]:
        """Names of the axes of a dataset with so many dimensions, as other programs read them."""
        shape = self.shape[self.several :]
        own: tuple[str, ...] = (_SHARED.get(self.components, f"{self.name}_component"),)
        if len(shape) > 1:
            square = shape == (3, 3)
            own = ("row", "column") if square else (f"{self.name}_row", f"{self.name}_column")
        before = self.lead[: dimensions - len(self.shape)]
        return (*before, *("body",) * self.several, *own[: len(shape)])

    @property
    def size(self) -> int:
        """How many numbers it is."""
        return math.prod(self.shape)

    @property
    def symbols(self) -> tuple[str, ...]:
        """The symbol of each component."""
        form = "{}_{}" if all(len(part) == 1 for part in self.components) else "{}_{{{}}}"
        return self.parts or tuple(form.format(self.symbol, part) for part in self.components)

    @property
    def heading(self) -> str:
        """Words and symbol, for the axis of a picture."""
        return self.label or self._headed(self.symbol)

    def _headed(self, symbol: str) -> str:
        words = self.name.replace("_", " ")
        return f"{words} ${symbol}$" if symbol else words

    def columns(self) -> list[Quantity]:
        """Its components as a quantity each, position_1 and so on; itself where it has none."""
        about = self.units, self.description, self.frame
        return [
            Quantity(f"{self.name}_{part}", symbol, *about, label=self._headed(symbol))
            for part, symbol in zip(self.components, self.symbols, strict=True)
        ] or [self]


def table(text: str) -> dict[str, Quantity]:
    """Quantities by name, one a line: name, symbol, units, description, kind, label and lead.

    A line that begins with a space goes on with the last one.
    kind: nothing for a number, one of `_KINDS`, or "mean" for a vector of mean values.
    """
    found = {}
    for line in text.replace("\n ", " ").strip().splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        name, symbol, units, description, kind, label, lead = cells + [""] * (7 - len(cells))
        frame, shape, components, parts = _KINDS.get(kind, ("space", (3,), _XYZ, ()))
        if kind == "mean":
            parts = tuple(rf"\langle {symbol}_{i}\rangle" for i in _XYZ)
            symbol = rf"\langle {symbol}\rangle"
        about = Quantity(name, symbol, units, description, frame, shape, components, parts, label)
        found[name] = replace(about, lead=tuple(lead.split()))
    return found


_KINDS: dict[str, tuple[str, tuple[int, ...], tuple[str, ...], tuple[str, ...]]] = {
    "": ("", (), (), ()),
    "vector": ("space", (3,), _XYZ, ()),
    "quaternion": ("body to space", (4,), ("0", *_XYZ), ()),
    "angles": ("body to space", (3,), _ANGLES, _ANGLE_SYMBOLS),
    "tensor": ("space", (6,), _PAIRS, tuple(rf"\sigma_{{{pair}}}" for pair in _PAIRS)),
    "stresses": ("space", (6,), _PAIRS, ()),
    "matrix": ("body", (6, 6), (), ()),
    "square": ("space", (3, 3), (), ()),
    "nine": ("space", (3, 3), tuple(f"{i}{j}" for i in "123" for j in "123"), ()),
    "axes": ("space", (3,), (), ()),
    "five": ("", (5,), ("0", "1", "2", "3", "4"), ()),
    "four": ("", (4,), ("0", "1", "2", "3"), ()),
    "numbers": ("", (4,), ("0", "1", "2", "1_held"), ("S_0", "S_1", "S_2", "S_1^{held}")),
    "modes": ("", (3,), ("X", "Y", "Z"), ("X^M", "Y^M", "Z^M")),
}
