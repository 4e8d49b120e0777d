"""The body model of a spheroid by closed forms, to compare with."""

from __future__ import annotations

from qbxstokes.bie.accuracy import model_distance
from qbxstokes.bie.functional import BodyModel, FaxenCoefficients, Resistance
from qbxstokes.reference import faxen


def exact_model(aspect_ratio: float) -> BodyModel:
    """The body model by the closed forms of Lamb, Jeffery and Faxen (Kim & Karrila 1991, ch. 3)."""
    linear, quadratic, cubic = faxen.body_coefficients(aspect_ratio)
    return BodyModel(
        aspect_ratio,
        Resistance(*faxen.resistance(aspect_ratio)),
        FaxenCoefficients(linear, quadratic, cubic),
        None,
        0.0,
    )


def true_error(model: BodyModel, degree: int = 3) -> float:
    """Largest relative error of a body model, in force, torque or motion in flows of a degree."""
    return model_distance(model, exact_model(model.aspect_ratio), degree)
