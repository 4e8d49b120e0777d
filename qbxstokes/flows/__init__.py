"""Background flows: Stokes flows in which the body moves."""

from qbxstokes.flows.base import Flow, SumFlow, TransformedFlow, add_flows
from qbxstokes.flows.changing import ChangingFlow
from qbxstokes.flows.check import check_regular, check_singularities, check_stokesian
from qbxstokes.flows.interpolation import Series
from qbxstokes.flows.named import Linear, Paraboloid, Shear, Uniform
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.flows.registry import REGISTRY, build_flow
from qbxstokes.flows.series import GradientSeries
from qbxstokes.flows.singularities import Rotlet, Stokeslet, Stresslet
from qbxstokes.flows.user import UserFlow, resolve_paths

__all__ = [
    "REGISTRY",
    "ChangingFlow",
    "Flow",
    "GradientSeries",
    "Linear",
    "Paraboloid",
    "PolynomialFlow",
    "Rotlet",
    "Series",
    "Shear",
    "Stokeslet",
    "Stresslet",
    "SumFlow",
    "TransformedFlow",
    "Uniform",
    "UserFlow",
    "add_flows",
    "build_flow",
    "check_regular",
    "check_singularities",
    "check_stokesian",
    "resolve_paths",
]
