"""The body model by closed forms, to compare with: of the shapes that have them."""

import math

from qbxstokes.bie.accuracy import model_distance
from qbxstokes.bie.functional import BodyModel, FaxenCoefficients, Resistance
from qbxstokes.geometry.shape import Shape
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.reference import faxen


def exact_model(shape: Shape) -> BodyModel | None:
    """The body model by the closed forms of Lamb, Jeffery and Faxen (Kim & Karrila 1991, ch. 3).

    None for a shape without closed forms.
    """
    if not isinstance(shape, Spheroid):
        return None
    linear, quadratic, cubic = faxen.body_coefficients(shape.aspect_ratio)
    return BodyModel(
        shape,
        Resistance(*faxen.resistance(shape.aspect_ratio)),
        FaxenCoefficients(linear, quadratic, cubic),
        None,
        0.0,
    )


def true_error(model: BodyModel, degree: int = 3) -> float:
    """Largest relative error of a body model, in force, torque or motion in flows of a degree.

    NaN where there are no closed forms.
    """
    exact = exact_model(model.shape)
    return math.nan if exact is None else model_distance(model, exact, degree)
