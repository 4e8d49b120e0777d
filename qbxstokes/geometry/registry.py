"""Shapes by name: a new shape is one new file and one line in `SHAPES`."""

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from qbxstokes.errors import SceneError, nearest
from qbxstokes.geometry.shape import Shape
from qbxstokes.geometry.spheroid import Spheroid

# Keys of a body that say its shape: exactly one of them is given.
SHAPE_KEYS = ("aspect_ratio", "length_over_diameter", "shape")
SHAPES: dict[str, type[Shape]] = {shape.name: shape for shape in (Spheroid,)}


def build_shape(
    aspect_ratio: float | None = None,
    length_over_diameter: float | None = None,
    shape: Shape | Mapping[str, Any] | None = None,
) -> Any:
    """The shape of a body, from exactly one of three: k or 1/k of a spheroid, or a shape.

    shape: an object, or its type and numbers, {"type": name, ...}. Raises SceneError with the key.
    """
    given = [value is not None for value in (aspect_ratio, length_over_diameter, shape)]
    if sum(given) != 1:
        right = "exactly one of aspect_ratio, length_over_diameter and shape"
        raise SceneError("body", "names its shape not once", right)
    for name, value in zip(SHAPE_KEYS, (aspect_ratio, length_over_diameter), strict=False):
        if value is not None and not isinstance(value, int | float | np.integer | np.floating):
            raise SceneError(name, f"is {value!r}", "one number; of several bodies one for each")
    if aspect_ratio is not None:
        return Spheroid(aspect_ratio)
    if length_over_diameter is not None:
        if not (length_over_diameter > 0.0 and math.isfinite(length_over_diameter)):
            raise SceneError("length_over_diameter", f"is {length_over_diameter:g}", "more than 0")
        return Spheroid(1.0 / length_over_diameter)
    if isinstance(shape, Shape):
        return shape
    if not isinstance(shape, Mapping) or "type" not in shape:
        right = f"a shape, or {{type: one of {', '.join(SHAPES)}, ...}}"
        raise SceneError("shape", f"is {shape!r}", right)
    numbers = {name: value for name, value in shape.items() if name != "type"}
    if shape["type"] not in SHAPES:
        raise SceneError("shape.type", f"is {shape['type']!r}", _nearest(shape["type"], SHAPES))
    made = SHAPES[shape["type"]]
    names = [field.name for field in fields(made)]  # type: ignore[arg-type]
    for name in numbers:
        if name not in names:
            raise SceneError(f"shape.{name}", "is no key of this shape", _nearest(name, names))
    for name in names:
        value = numbers.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            wrong = "is missing" if name not in numbers else f"is {value!r}"
            raise SceneError(f"shape.{name}", wrong, "a number")
    try:
        return made(**{name: float(value) for name, value in numbers.items()})
    except SceneError as error:
        raise SceneError(f"shape.{error.key}", error.wrong, error.right) from None


def _nearest(word: Any, known: Any) -> str:
    return nearest(str(word), known, f"known here: {', '.join(known)}")
