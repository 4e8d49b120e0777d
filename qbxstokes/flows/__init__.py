"""Background flows: Stokes flows in which the body moves."""

from qbxstokes.flows.base import Flow
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.flows.registry import REGISTRY, build_flow

__all__ = ["REGISTRY", "Flow", "PolynomialFlow", "build_flow"]
