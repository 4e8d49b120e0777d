"""From the section `hydrodynamics` to the body model and the provider of free motion."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from qbxstokes.bie.accuracy import (
    AccurateBody,
    RowFormer,
    accurate_body,
    choose_scheme,
    resolving_nodes,
)
from qbxstokes.bie.functional import BodyModel
from qbxstokes.case.hydrodynamics import GRADED_KEYS, Hydrodynamics
from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import CaseError, FlowError
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.cache import Cache, default_folder
from qbxstokes.qbx.operator import (
    GradedScheme,
    Scheme,
    UniformScheme,
    independent_rows,
    layer_rows,
)
from qbxstokes.runs.plan import Plan

# GMRES residual over the tolerance asked for, so that the solve is not what limits the accuracy.
_SOLVE_MARGIN = 1e-2
_TIGHTEST_SOLVE = 1e-14
# Share of the tolerance that the grid of a flow that is not polynomial may take.
_FLOW_SHARE = 0.1


@dataclass
class Hydrodynamic:
    """The body model, what the equations of motion ask at each step, and how it was obtained."""

    model: BodyModel
    provider: Any
    facts: dict[str, Any] = field(default_factory=dict)
    solvers: list[Any] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    def solves(self) -> dict[str, Any]:
        """Number of GMRES solves so far, their iterations and worst true residual."""
        records = [record for solver in self.solvers for record in solver.records]
        return {
            "solves": len(records),
            "iterations": sum(record.iterations for record in records),
            "most_iterations": max((record.iterations for record in records), default=0),
            "true_residual": max((record.true_residual for record in records), default=0.0),
        }


def form_hydrodynamics(
    loaded: LoadedCase,
    plan: Plan,
    form_rows: RowFormer = layer_rows,
    cache: Cache | None = None,
) -> Hydrodynamic:
    """Form operators, solve the adjoint problems, and choose what a time step evaluates.

    form_rows: what forms rows, several ranks perhaps. cache: where results are kept, if anywhere.
    """
    return _Former(loaded, plan, form_rows, cache or Cache(None)).form()


def open_cache(loaded: LoadedCase, off: bool = False) -> Cache:
    """The cache of a run: folder of the case, of QBXSTOKES_CACHE, or of the user, in this order."""
    named = loaded.case.hydrodynamics.cache
    return Cache(None if off else Path(named).expanduser() if named else default_folder())


class _Former:
    """The steps of `form_hydrodynamics`, which share the case and what has been formed so far."""

    def __init__(self, loaded: LoadedCase, plan: Plan, form_rows: RowFormer, cache: Cache) -> None:
        self._loaded, self._plan, self._cache = loaded, plan, cache
        self._form_rows = form_rows
        self._section = loaded.case.hydrodynamics
        self._flow = loaded.flow
        self._spheroid = Spheroid(loaded.case.body.aspect_ratio)
        self._residual = solver_tolerance(self._section)
        self._solvers: list[Any] = []

    def form(self) -> Hydrodynamic:
        found = self._cache.found
        body = self._body()
        facts = {
            "scheme": self._section.scheme,
            "completion": self._plan.completion,
            "gmres_tolerance": self._residual,
            "cache": "found" if self._cache.found > found else "formed",
            "n_phi": body.functional.grid.n_phi,
            **vars(body.scheme),
        }
        if body.model.error_parts is not None:
            facts["error_parts"] = asdict(body.model.error_parts)
        provider: Any = self._flow.polynomial
        if self._plan.hydrodynamics == "every_step":
            provider = self._solve_motion(body, facts)
        elif self._plan.hydrodynamics == "grid":
            provider = self._grid_motion(body, facts)
        return Hydrodynamic(body.model, provider, facts, self._solvers, self._cache.problems)

    def _body(self) -> AccurateBody:
        """The body model and its functional, from the cache if it has them."""
        section = self._section
        scheme = explicit_scheme(section)
        degree = 3 if self._flow.degree is None else min(3, max(1, self._flow.degree))
        key = {
            "aspect_ratio": self._spheroid.aspect_ratio,
            "degree": degree,
            "tolerance": section.tolerance,
            "side": side_of(section),
            "scheme": None if scheme is None else [section.scheme, asdict(scheme)],
            "completion": self._plan.completion,
            "residual": self._residual,
            "preconditioner": section.preconditioner,
        }
        arrays = self._cache.load("body", key)
        if arrays is None and self._plan.completion is None:
            # A body with its resistance serves as well: whether there is one changes no output.
            arrays = self._cache.load("body", {**key, "completion": "surface"})
            if arrays is not None:
                del arrays["model_resistance"]
        if arrays is not None:
            return AccurateBody.from_arrays(arrays)
        try:
            body = accurate_body(
                self._spheroid,
                section.tolerance,
                scheme,
                side=side_of(section),
                degree=degree,
                strict="tolerance" in section.model_fields_set,
                completion=self._plan.completion,
                solver=self._solver,
                form_rows=self._form_rows,
            )
        except CaseError as error:
            raise self._loaded.error("hydrodynamics", str(error)) from None
        self._cache.store("body", key, body.to_arrays())
        return body

    def _solver(self, operator: Any, grid: Any) -> Any:
        from qbxstokes.petsc.gmres import GmresSolver

        solver = GmresSolver(operator, grid, self._residual, self._section.preconditioner)
        self._solvers.append(solver)
        return solver

    def _grid_motion(self, body: AccurateBody, facts: dict[str, Any]) -> Any:
        from qbxstokes.bie.providers import AdaptiveGridMotion, GridMotion, MonitoredGridMotion

        if body.functional.grid.nodes != "cosine" or self._section.n_phi is not None:
            n_phi = self._section.n_phi or 2 * body.functional.grid.n_theta
            return GridMotion(body.functional.on_grid(n_phi), self._flow)
        n_theta, n_phi, error = self._nodes(body)
        facts |= {"flow_nodes": [n_theta, n_phi], "flow_error": error}
        share = _FLOW_SHARE * self._section.tolerance
        if not len(self._flow.singular_points):
            return MonitoredGridMotion(body.functional, self._flow, share, (n_theta, n_phi))
        motion = AdaptiveGridMotion(body.functional, self._flow, share)
        motion.calibrate(self._plan.position, self._plan.quaternion, n_theta)
        return motion

    def _nodes(self, body: AccurateBody) -> tuple[int, int, float]:
        """Nodes that resolve the flow on the surface at the start, and the error they leave."""
        turn = rotation.matrix(self._plan.quaternion)

        def velocity(points: Any) -> Any:
            return self._flow.velocity(self._plan.position + points @ turn.T, 0.0) @ turn

        try:
            return resolving_nodes(body.functional, velocity, _FLOW_SHARE * self._section.tolerance)
        except FlowError as error:
            raise self._loaded.error("flow", str(error), "move the body away") from None

    def _solve_motion(self, body: AccurateBody, facts: dict[str, Any]) -> Any:
        from qbxstokes.bie.operators import surface_operators
        from qbxstokes.bie.providers import SolveMotion

        scheme: Scheme = body.scheme
        degree, n_phi = self._flow.degree, self._section.n_phi
        if isinstance(scheme, GradedScheme) and degree is None:
            n_theta, needed, error = self._nodes(body)
            facts |= {"flow_nodes": [n_theta, needed], "flow_error": error}
            n_phi = n_phi or needed | 1
            if explicit_scheme(self._section) is None and n_theta > scheme.n_theta:
                scheme = choose_scheme(self._section.tolerance, n_theta, scheme.side)
        # A flow of degree d excites modes up to d + 1, which 2 d + 4 nodes keep from aliasing. An
        # odd number has no mode of half its own, which the preconditioner cannot invert.
        n_phi = n_phi or (2 * scheme.n_theta if degree is None else 2 * degree + 4) | 1
        facts |= {**vars(scheme), "n_phi": n_phi}
        completion = self._plan.completion
        spread = completion == "surface"
        n_modes = n_phi // 2 + 1
        key = {
            "aspect_ratio": self._spheroid.aspect_ratio,
            "scheme": [self._section.scheme, asdict(scheme)],
            "n_modes": n_modes,
            "single": spread,
        }
        arrays = self._cache.load("operator", key)
        if arrays is None:
            wanted = independent_rows(scheme.n_theta)
            rows = self._form_rows(self._spheroid, scheme, n_modes, wanted, spread)
            self._cache.store("operator", key, {"double": rows[0], "single": rows[1]})
        else:
            rows = arrays["double"], arrays["single"]
        operators = surface_operators(self._spheroid, scheme, n_phi, completion, rows)
        return SolveMotion(operators, self._flow, self._solver)


def side_of(section: Hydrodynamics) -> Any:
    """Side of the expansions: as asked, else inner, or both for the uniform scheme."""
    return section.expansion or ("inner" if section.scheme == "graded" else "average")


def explicit_scheme(section: Hydrodynamics) -> Scheme | None:
    """The scheme of the numbers that the case sets, completed from the tolerance; or None."""
    if section.scheme == "uniform":
        return UniformScheme(
            n_theta=section.n_theta or 0,
            n_phi=section.n_phi or 0,
            expansion_order=section.expansion_order or 0,
            r_over_h=section.r_over_h or 0.0,
            upsampling=section.upsampling or 0,
            side=side_of(section),
            coefficients=section.coefficients or False,
        )
    names = ("n_theta", "expansion_order", *GRADED_KEYS)
    chosen = {name: getattr(section, name) for name in names if getattr(section, name) is not None}
    if not chosen:
        return None
    nodes = {"n_theta": section.n_theta} if section.n_theta else {}
    rest = choose_scheme(section.tolerance, side=side_of(section), **nodes)
    return GradedScheme(**{**asdict(rest), **chosen})


def solver_tolerance(section: Hydrodynamics) -> float:
    """Relative residual that GMRES has to reach."""
    if section.gmres_tolerance is not None:
        return section.gmres_tolerance
    return max(_SOLVE_MARGIN * section.tolerance, _TIGHTEST_SOLVE)
