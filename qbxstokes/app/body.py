"""From the section `hydrodynamics` to the body model and the provider of free motion."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from qbxstokes.app.plan import Plan
from qbxstokes.bie.functional import BodyModel
from qbxstokes.config.hydrodynamics import Hydrodynamics
from qbxstokes.config.load import LoadedCase
from qbxstokes.errors import CaseError

# Flows that are not polynomial excite every mode; this grid resolves a point singularity two body
# lengths away to rounding.
_N_THETA_GENERAL = 32
# GMRES residual over the tolerance asked for, so that the solve is not what limits the accuracy.
_SOLVE_MARGIN = 1e-2
_TIGHTEST_SOLVE = 1e-14


@dataclass
class Hydrodynamic:
    """The body model, what the equations of motion ask at each step, and how it was obtained."""

    model: BodyModel
    provider: Any
    facts: dict[str, Any] = field(default_factory=dict)
    solvers: list[Any] = field(default_factory=list)

    def solves(self) -> dict[str, Any]:
        """Number of GMRES solves so far, their iterations and worst true residual."""
        records = [record for solver in self.solvers for record in solver.records]
        return {
            "solves": len(records),
            "iterations": sum(record.iterations for record in records),
            "most_iterations": max((record.iterations for record in records), default=0),
            "true_residual": max((record.true_residual for record in records), default=0.0),
        }


def form_hydrodynamics(loaded: LoadedCase, plan: Plan) -> Hydrodynamic:
    """Form operators, solve the adjoint problems, and choose what a time step evaluates."""
    from qbxstokes.bie.operators import form_body_model, modal_functional, surface_operators
    from qbxstokes.bie.providers import GridMotion, SolveMotion
    from qbxstokes.geometry.spheroid import Spheroid
    from qbxstokes.petsc.gmres import GmresSolver

    section, flow = loaded.case.hydrodynamics, loaded.flow
    scheme = scheme_of(loaded, plan)
    tolerance = solver_tolerance(section)
    solvers: list[GmresSolver] = []

    def solver(operator: Any, grid: Any) -> GmresSolver:
        solvers.append(GmresSolver(operator, grid, tolerance, section.preconditioner))
        return solvers[-1]

    n_phi = 3 if plan.hydrodynamics != "every_step" else azimuthal_nodes(loaded, scheme.n_theta)
    spheroid = Spheroid(loaded.case.body.aspect_ratio)
    try:
        operators = surface_operators(spheroid, scheme, n_phi, section.completion)
    except CaseError as error:
        raise loaded.error("hydrodynamics", str(error)) from None
    model = form_body_model(operators, solver)
    provider: Any = flow.polynomial
    if plan.hydrodynamics == "every_step":
        provider = SolveMotion(operators, flow, solver)
    elif plan.hydrodynamics == "grid":
        functional = modal_functional(operators, solver)
        provider = GridMotion(functional.on_grid(azimuthal_nodes(loaded, scheme.n_theta)), flow)
    facts = {
        "scheme": section.scheme,
        **{name: value for name, value in vars(scheme).items() if not name.startswith("_")},
        "n_phi": n_phi,
        "completion": section.completion,
        "gmres_tolerance": tolerance,
    }
    return Hydrodynamic(model, provider, facts, solvers)


def scheme_of(loaded: LoadedCase, plan: Plan) -> Any:
    """The quadrature scheme of the case: what it sets, and the scheme's own choice of the rest."""
    from qbxstokes.qbx.operator import GradedScheme, UniformScheme

    section = loaded.case.hydrodynamics
    if section.scheme == "uniform":
        return UniformScheme(
            n_theta=section.n_theta or 0,
            n_phi=section.n_phi or 0,
            expansion_order=section.expansion_order or 0,
            r_over_h=section.r_over_h or 0.0,
            upsampling=section.upsampling or 0,
            side=section.expansion,
        )
    names = ("n_theta", "expansion_order", "radius_factor", "panel_order", "panel_ratio")
    chosen = {name: getattr(section, name) for name in names if getattr(section, name) is not None}
    if loaded.flow.degree is None:
        chosen.setdefault("n_theta", _N_THETA_GENERAL)
    return GradedScheme(**chosen, side=section.expansion)


def azimuthal_nodes(loaded: LoadedCase, n_theta: int) -> int:
    """Azimuthal nodes of the grid on which the flow is evaluated.

    A flow of degree d excites modes up to d + 1, which 2 d + 4 nodes keep from aliasing.
    """
    degree, asked = loaded.flow.degree, loaded.case.hydrodynamics.n_phi
    return asked or (2 * n_theta if degree is None else 2 * degree + 4)


def solver_tolerance(section: Hydrodynamics) -> float:
    """Relative residual that GMRES has to reach."""
    if section.gmres_tolerance is not None:
        return section.gmres_tolerance
    return max(_SOLVE_MARGIN * section.tolerance, _TIGHTEST_SOLVE)
