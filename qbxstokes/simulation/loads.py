"""From the sections `forces` and `constraints` to the loads and constraints of the equations."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.case.constraints import FREE, LOCKED
from qbxstokes.case.load import LoadedCase
from qbxstokes.case.timed import timed
from qbxstokes.errors import CaseError, FlowError
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import Constraints, Loads

Array = NDArray[np.float64]

_LOADS = ("force", "torque", "body_force", "body_torque")


def loads_and_constraints(
    loaded: LoadedCase, end: float
) -> tuple[Loads | None, Constraints | None]:
    """Loads and constraints of the case, None where there are none; `end` of the motion.

    Raises CaseError for a table or function that cannot be used.
    """
    forces, held = loaded.case.forces, loaded.case.constraints
    loads = None
    if forces.given:
        parts: dict[str, Any] = {
            name: _vector(loaded, ("forces", name), getattr(forces, name), end)
            for name in _LOADS
            if getattr(forces, name) is not None
        }
        if forces.gravity is not None:
            parts["force"] = _sum(parts.get("force"), weight(loaded))
        loads = Loads(**parts)
    constraints = None
    if held.given:
        constraints = Constraints(
            *(
                _bound(loaded, name, getattr(held, name), end)
                for name in ("translation", "rotation")
            )
        )
    return loads, constraints


def weight(loaded: LoadedCase) -> Array:
    """Weight less buoyancy, (3,): Theta G e (see `config.forces.Gravity`)."""
    case = loaded.case
    gravity = case.forces.gravity
    assert gravity is not None
    direction = np.array(gravity.direction)
    volume = Spheroid(case.body.aspect_ratio).volume
    net = gravity.net(case.body.stokes_number)
    return np.asarray(volume * net * direction / np.linalg.norm(direction))


def _sum(first: Any, constant: Array) -> Any:
    if first is None:
        return constant
    if callable(first):
        return lambda t: np.asarray(first(t)) + constant
    return first + constant


def _bound(loaded: LoadedCase, name: str, value: Any, end: float) -> Any:
    if value == FREE:
        return None
    if value == LOCKED:
        return np.zeros(3)
    return _vector(loaded, ("constraints", name), value, end)


def _vector(loaded: LoadedCase, key: tuple[str, str], value: Any, end: float) -> Any:
    try:
        return timed(value, loaded.path.parent, end)
    except (CaseError, FlowError) as error:
        raise loaded.error(key, str(error)) from None
