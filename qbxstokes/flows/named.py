"""The polynomial flows that have a name; each constructor's arguments are its case-file keys.

Directions are those of the space frame: the stream runs along e1 and varies along e2 (and e3).
`position` and `rotation` beside the keys below move and turn any of them.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError
from qbxstokes.flows.base import Build, Flow
from qbxstokes.flows.domain import channel, tube
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.flows.values import check_keys, number, settled, tensor, traceless
from qbxstokes.typing import Array

_EXTENSIONS = {
    "uniaxial": (1.0, -0.5, -0.5),
    "biaxial": (1.0, 1.0, -2.0),
    "planar": (1.0, -1.0, 0.0),
}


class Uniform(PolynomialFlow):
    """u = velocity."""

    type_name = "uniform"
    linear_in = ("velocity",)

    def __init__(self, velocity: ArrayLike = (1.0, 0.0, 0.0)) -> None:
        value = tensor(velocity, "velocity", (3,))
        super().__init__(value)
        self._spec = {"type": self.type_name, "velocity": value.tolist()}


class Linear(PolynomialFlow):
    """u = A x with a traceless gradient A[i, j] = du_i/dx_j."""

    type_name = "linear"
    linear_in = ("gradient",)

    @classmethod
    def keys(cls) -> dict[str, Any]:
        """`gradient`, and `trajectory` of a series of several paths."""
        return {**super().keys(), "trajectory": None}

    @classmethod
    def unchecked(cls, spec: Mapping[str, Any], build: Build) -> PolynomialFlow:
        """The flow of a gradient that may have a trace."""
        check_keys(spec, ["gradient"], cls.type_name)
        return PolynomialFlow(gradient=spec["gradient"])

    @classmethod
    def from_spec(cls, spec: Mapping[str, Any], build: Build) -> Flow:
        """The flow {"gradient": 3 x 3 numbers}."""
        check_keys(spec, ["gradient"], cls.type_name)
        return super().unchecked(spec, build)

    def __init__(self, gradient: ArrayLike) -> None:
        """Raises FlowError if the gradient has a trace."""
        matrix = tensor(gradient, "gradient", (3, 3))
        must = f"the gradient, of trace {np.trace(matrix):.6g}, must have none (div u = 0)"
        matrix = settled(matrix, traceless(matrix), must, ("gradient",))
        super().__init__(gradient=matrix)
        self._spec = {"type": self.type_name, "gradient": matrix.tolist()}


class Shear(PolynomialFlow):
    """Linear shear u = rate (x2, 0, 0)."""

    type_name = "shear"
    linear_in = ("rate",)

    def __init__(self, rate: float = 1.0) -> None:
        shear_rate = number(rate, "rate")
        gradient = np.zeros((3, 3))
        gradient[0, 1] = shear_rate
        super().__init__(gradient=gradient)
        self._spec = {"type": self.type_name, "rate": shear_rate}


class Extension(PolynomialFlow):
    """Extension without rotation: u = rate (x1, -x2/2, -x3/2) of kind `uniaxial`,
    rate (x1, x2, -2 x3) of kind `biaxial`, rate (x1, -x2, 0) of kind `planar`.
    """

    type_name = "extension"
    linear_in = ("rate",)

    def __init__(self, rate: float = 1.0, kind: str = "uniaxial") -> None:
        """Raises FlowError for a kind other than uniaxial, biaxial, planar."""
        if not isinstance(kind, str) or kind not in _EXTENSIONS:
            raise FlowError(
                f"kind of extension must be one of {', '.join(_EXTENSIONS)}, not {kind!r}",
                ("kind",),
            )
        strain_rate = number(rate, "rate")
        super().__init__(gradient=strain_rate * np.diag(_EXTENSIONS[kind]))
        self._spec = {"type": self.type_name, "rate": strain_rate, "kind": kind}


class Rotation(PolynomialFlow):
    """Rigid rotation u = angular_velocity x x."""

    type_name = "rotation"
    linear_in = ("angular_velocity",)

    def __init__(self, angular_velocity: ArrayLike = (0.0, 0.0, 1.0)) -> None:
        omega = tensor(angular_velocity, "angular_velocity", (3,))
        a, b, c = omega
        super().__init__(gradient=[[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
        self._spec = {"type": self.type_name, "angular_velocity": omega.tolist()}


def _stream_hessian(curvature_2: float, curvature_3: float) -> Array:
    """Second derivatives of (curvature_2 x2^2 + curvature_3 x3^2) e1."""
    hessian = np.zeros((3, 3, 3))
    hessian[0, 1, 1] = 2.0 * curvature_2
    hessian[0, 2, 2] = 2.0 * curvature_3
    return hessian


class Paraboloid(PolynomialFlow):
    """u = (K2 x2^2 + K3 x3^2) e1; one number `curvature` K means K2 = K3 = K.

    K is nondimensional: in time units 1/(2 K eta0), where the shear rate at x2 = eta0 is one, it
    is 1/(2 eta0).
    """

    type_name = "paraboloid"
    linear_in = ("curvature",)

    def __init__(self, curvature: Any = 1.0) -> None:
        """Raises FlowError unless curvature is one number or two."""
        if not isinstance(curvature, Sequence | np.ndarray) or isinstance(curvature, str):
            pair = [number(curvature, "curvature")] * 2
        else:
            pair = tensor(curvature, "curvature", (2,)).tolist()
        super().__init__(hessian=_stream_hessian(*pair))
        kept = pair[0] if pair[0] == pair[1] else pair
        self._spec = {"type": self.type_name, "curvature": kept}


class WallStagnation(PolynomialFlow):
    """Fluid that meets the wall x2 = 0, at rest on it: rate (x1 x2, -x2^2, x2 x3), or planar.

    planar: rate (2 x1 x2, -x2^2, 0).
    """

    type_name = "wall_stagnation"
    linear_in = ("rate",)

    def __init__(self, rate: float = 1.0, kind: str = "axisymmetric") -> None:
        """Raises FlowError for an unknown kind."""
        shares = {"axisymmetric": (1.0, 1.0), "planar": (2.0, 0.0)}
        if not isinstance(kind, str) or kind not in shares:
            raise FlowError(f"kind is {kind!r}; one of {', '.join(shares)}", ("kind",))
        strength = number(rate, "rate")
        hessian = np.zeros((3, 3, 3))
        hessian[1, 1, 1] = -2.0
        for i, share in zip((0, 2), shares[kind], strict=True):
            hessian[i, i, 1] = hessian[i, 1, i] = share
        super().__init__(hessian=strength * hessian)
        self._spec = {"type": self.type_name, "rate": strength, "kind": kind}


class PlanePoiseuille(PolynomialFlow):
    """Flow between plates at x2 = +-half_width: u = speed (1 - x2^2/half_width^2) e1."""

    type_name = "plane_poiseuille"
    linear_in = ("speed",)

    def __init__(self, half_width: float, speed: float = 1.0) -> None:
        width = number(half_width, "half_width", positive=True)
        top = number(speed, "speed")
        hessian = _stream_hessian(-top / width / width, 0.0)
        super().__init__((top, 0.0, 0.0), hessian=hessian, domain=channel(width))
        self._spec = {"type": self.type_name, "half_width": width, "speed": top}


class TubePoiseuille(PolynomialFlow):
    """Flow in a tube along e1: u = speed (1 - (x2^2 + x3^2)/radius^2) e1."""

    type_name = "tube_poiseuille"
    linear_in = ("speed",)

    def __init__(self, radius: float, speed: float = 1.0) -> None:
        width = number(radius, "radius", positive=True)
        top = number(speed, "speed")
        hessian = _stream_hessian(*[-top / width / width] * 2)
        super().__init__((top, 0.0, 0.0), hessian=hessian, domain=tube(width))
        self._spec = {"type": self.type_name, "radius": width, "speed": top}
