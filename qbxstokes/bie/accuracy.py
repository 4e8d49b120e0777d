"""From a tolerance to parameters, and from a discretisation to an estimate of its error.

Three facts make the choice short (all measured in tests/test_accuracy.py, none a closed form).
Inside a spheroid the double layer of a polynomial density is a polynomial of the same degree, so
that inner expansions of order n_theta + 2 truncate nothing. The quadrature error falls by a fixed
number of digits per panel node, the same for every aspect ratio. And the error of the functional in
a flow that is singular outside the body falls by the rate `Shape.decay` per node.

The estimate compares resolutions: each part is the change of the result when the one parameter
behind it is refined, rounding the change under perturbations of its size, resolution the last
coefficients of the adjoint densities.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol, TypeVar

import numpy as np

from qbxstokes.bie.functional import BodyModel, ErrorParts, ModalFunctional
from qbxstokes.bie.operators import (
    DirectSolver,
    SolverFactory,
    body_model,
    form_body_model,
    modal_functional,
    surface_operators,
)
from qbxstokes.bie.resolution import POLYNOMIAL_NODES
from qbxstokes.bie.rigid import Completion
from qbxstokes.errors import CaseError, ConvergenceError
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.shape import Revolution
from qbxstokes.qbx.operator import (
    GradedScheme,
    Scheme,
    Side,
    UniformScheme,
    impose_rigid_motions,
    independent_rows,
    layer_rows,
)
from qbxstokes.typing import Array

# log10 of the quadrature error of inner expansions (order 8, radius factor 0.3, panel ratio 0.7) is
# at most LOSS - GAIN * panel_order over 1/50 <= k <= 50; scanned in steps of 2 from 6 to 12.
_GAIN, _LOSS = 1.4, 4.0
# With more nodes an expansion of order n_theta + 2 costs more than one that truncates.
_MOST_INNER_NODES = 10
# The same for expansions that truncate, of radius factor 0.1, and digits per order there.
_OUTER_GAIN, _OUTER_LOSS, _OUTER_DIGITS_PER_ORDER = 1.1, 4.0, 0.75
# Digits by which the choice stays below the tolerance; the estimate decides whether they sufficed.
_MARGIN = 1.5
_MOST_PANEL_NODES = 30
# Size of one rounding error of the assembled rows in units of eps times 4 pi; a few times what the
# scatter of the results under changes of the panels shows.
_ROUNDING = 0.2
_PERTURBATIONS = 8
# Rounding of everything after the assembly, which no perturbation of it shows.
ROUNDING_FLOOR = 100.0 * float(np.finfo(float).eps)


class RowFormer(Protocol):
    """What forms rows of the layer potentials: `layer_rows`, or several processes at once."""

    def __call__(
        self,
        shape: Revolution,
        scheme: Scheme,
        n_modes: int,
        rows: Sequence[int],
        with_single: bool = False,
    ) -> tuple[Array, Array]:
        """The result of `qbx.operator.layer_rows`."""


def choose_scheme(
    tolerance: float, n_theta: int = POLYNOMIAL_NODES, side: Side = "inner"
) -> GradedScheme:
    """Cheapest parameters of the scanned family whose error stays below the tolerance."""
    digits = -math.log10(min(tolerance, 0.1)) + _MARGIN
    if side == "inner" and n_theta <= _MOST_INNER_NODES:
        order = max(4, math.ceil((digits + _LOSS) / _GAIN))
        return GradedScheme(n_theta, n_theta + 2, 0.3, min(order, _MOST_PANEL_NODES), 0.7, side)
    expansion = math.ceil(digits / _OUTER_DIGITS_PER_ORDER) + 2
    # Every order of the expansion magnifies the quadrature's error a little more.
    order = math.ceil((digits + _OUTER_LOSS + 0.1 * expansion) / _OUTER_GAIN)
    return GradedScheme(n_theta, expansion, 0.1, min(order, _MOST_PANEL_NODES), 0.7, side)


@dataclass(frozen=True)
class AccurateBody:
    """A body model with its functional, the scheme that was used, and the error in parts."""

    model: BodyModel
    functional: ModalFunctional
    scheme: Scheme

    def to_arrays(self) -> dict[str, Array]:
        """Plain arrays that hold it, for storage; `from_arrays` restores it."""
        names = [field.name for field in fields(self.scheme)]
        values = [getattr(self.scheme, name) for name in names]
        return {
            **{f"model_{name}": value for name, value in self.model.to_arrays().items()},
            **{f"weight_{name}": value for name, value in self.functional.weights.items()},
            "scheme": np.array(json.dumps([type(self.scheme).__name__, values])),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> AccurateBody:
        """Body of the arrays that `to_arrays` made."""
        parts: dict[str, dict[str, Array]] = {"model": {}, "weight": {}}
        for name, value in arrays.items():
            kind, _, rest = name.partition("_")
            if kind in parts:
                parts[kind][rest] = value
        model = BodyModel.from_arrays(parts["model"])
        kind, values = json.loads(str(arrays["scheme"]))
        scheme: Scheme = {"GradedScheme": GradedScheme, "UniformScheme": UniformScheme}[kind](
            *values
        )
        assert isinstance(model.shape, Revolution)
        grid = scheme.grid(model.shape, 3)
        return cls(model, ModalFunctional(grid, parts["weight"]), scheme)


def accurate_body(
    shape: Revolution,
    tolerance: float,
    scheme: Scheme | None = None,
    *,
    side: Side = "inner",
    degree: int = 3,
    strict: bool = True,
    completion: Completion | None = "surface",
    solver: SolverFactory = DirectSolver,
    form_rows: RowFormer = layer_rows,
) -> AccurateBody:
    """The body model to a relative tolerance, refined until the estimate meets it.

    scheme: parameters that an expert fixed; then nothing is refined and the estimate only reported.
    degree: of a polynomial flow; what only flows of higher degree would feel is not estimated.
    completion: None leaves out the resistance, which a body on which no force acts never asks for.
    strict: raise ConvergenceError if rounding keeps the estimate above the tolerance (bodies
    thinner than about 1/50); otherwise the best that can be had is returned with its estimate.
    """
    if not shape.fore_aft:
        raise CaseError(f"the law of a body without fore-aft symmetry is not known: {shape}")

    def formed(trial: Scheme) -> tuple[AccurateBody, ErrorParts]:
        body = _form(shape, trial, completion, solver, form_rows)
        return body, estimate_error(body, completion, form_rows, degree)

    first = scheme or choose_scheme(tolerance, side=side)
    body, parts = refined(formed, first, tolerance, fixed=scheme is not None)
    if strict and scheme is None and parts.total > tolerance:
        raise ConvergenceError(
            f"the estimated error {parts.total:.1e} of the hydrodynamics exceeds the tolerance "
            f"{tolerance:.1e} for the {shape} (quadrature "
            f"{parts.quadrature:.0e}, truncation {parts.truncation:.0e}, resolution "
            f"{parts.resolution:.0e}, solver {parts.solver:.0e}, rounding {parts.rounding:.0e}); "
            f"set hydrodynamics.tolerance to {2.0 * parts.total:.0e} or more"
        )
    model = replace(
        body.model, error_estimate=max(parts.total, body.model.error_estimate), error_parts=parts
    )
    return AccurateBody(model, body.functional, body.scheme)


def plain_body(shape: Revolution, scheme: Scheme) -> AccurateBody:
    """The body model of a given scheme; its estimate is the misfit of the polynomial law alone."""
    body = _form(shape, scheme, "surface", DirectSolver, layer_rows)
    return AccurateBody(body.model, body.functional, scheme)


Found = TypeVar("Found")


def refined(
    formed: Callable[[Scheme], tuple[Found, ErrorParts]],
    scheme: Scheme,
    tolerance: float,
    fixed: bool,
) -> tuple[Found, ErrorParts]:
    """What is formed of a scheme: a fixed one, or one refined until the error is tolerated."""
    for _ in range(4):
        found, parts = formed(scheme)
        finer = None if isinstance(scheme, UniformScheme) else refined_scheme(scheme, parts)
        if fixed or parts.total <= tolerance or finer is None:
            break
        scheme = finer
    return found, parts


def refined_scheme(scheme: GradedScheme, parts: ErrorParts) -> GradedScheme | None:
    """The scheme with its weakest parameter raised, None if none of them is to blame."""
    worst = max(("quadrature", "truncation", "resolution"), key=lambda name: getattr(parts, name))
    if max(parts.rounding, parts.solver) >= getattr(parts, worst):
        return None
    if worst == "quadrature":
        if scheme.panel_order >= _MOST_PANEL_NODES:
            return None
        return replace(scheme, panel_order=min(scheme.panel_order + 3, _MOST_PANEL_NODES))
    if worst == "truncation":
        return replace(scheme, expansion_order=scheme.expansion_order + 4)
    return replace(scheme, n_theta=scheme.n_theta + 4, expansion_order=scheme.expansion_order + 4)


@dataclass(frozen=True)
class _Body(AccurateBody):
    rows: tuple[Array, Array]
    direct: ModalFunctional


def _form(
    shape: Revolution,
    scheme: Scheme,
    completion: Completion | None,
    solver: SolverFactory,
    form_rows: RowFormer,
) -> _Body:
    spread = completion == "surface"
    rows = form_rows(shape, scheme, 2, independent_rows(shape, scheme.n_theta), spread)
    operators = surface_operators(shape, scheme, 3, completion, rows)
    functional = modal_functional(operators, solver)
    direct = functional if solver is DirectSolver else modal_functional(operators)
    return _Body(body_model(operators, functional), functional, scheme, rows, direct)


def estimate_error(
    body: AccurateBody,
    completion: Completion | None = "surface",
    form_rows: RowFormer = layer_rows,
    degree: int = 3,
) -> ErrorParts:
    """Relative errors of resistance and free motion by cause; costs about two more set-ups.

    No closed form enters. A part is zero where it does not exist.
    """
    scheme, shape = body.scheme, body.functional.grid.shape
    if not isinstance(body, _Body):
        body = _form(shape, scheme, completion, DirectSolver, form_rows)
    solver = 0.0
    if body.direct is not body.functional:
        operators = surface_operators(shape, scheme, 3, completion, body.rows)
        solver = model_distance(body.model, body_model(operators, body.direct), degree)
    rounding = _rounding(body, completion, degree)

    def formed(other: Scheme) -> _Body:
        return _form(shape, other, completion, DirectSolver, form_rows)

    def distance(one: AccurateBody, other: AccurateBody) -> float:
        return model_distance(one.model, other.model, degree)

    def tail(found: AccurateBody) -> float:
        resolution, used = adjoint_tail(found.functional), found.scheme
        if completion != "point":
            return resolution
        # The flow of a point in the body is no polynomial on its surface: only more nodes tell.
        denser = replace(used, n_theta=used.n_theta + 4, expansion_order=used.expansion_order + 4)
        return max(resolution, 1.5 * distance(found, formed(denser)))

    return parts_of(body, scheme, formed, distance, tail, solver, rounding)


def parts_of(
    found: Found,
    scheme: Scheme,
    formed: Callable[[Scheme], Found],
    distance: Callable[[Found, Found], float],
    tail: Callable[[Found], float],
    solver: float,
    rounding: float,
) -> ErrorParts:
    """Errors of what was found by a scheme, from its distances to what finer ones give.

    formed: by another scheme. tail: what the nodes leave out, by the last coefficients.
    """
    if isinstance(scheme, UniformScheme):
        others = coarser_schemes(scheme).items()
        changes = {name: distance(found, formed(other)) for name, other in others}
        return ErrorParts(**changes, solver=solver, rounding=rounding)
    finer = replace(scheme, panel_order=scheme.panel_order + 2)
    panels = formed(finer)
    both = formed(replace(finer, expansion_order=scheme.expansion_order + 2))
    # A difference no larger than the rounding errors of its terms shows these, counted already.
    # The finer one errs as well, by less.
    quadrature = max(1.5 * distance(found, panels) - rounding, 0.0)
    truncation = max(1.5 * distance(panels, both) - rounding, 0.0)
    # The tail is of the finest panels, whose quadrature adds the least to the coefficients.
    return ErrorParts(quadrature, truncation, tail(both), solver, rounding)


def coarser_schemes(scheme: UniformScheme) -> dict[str, UniformScheme]:
    """Schemes with one parameter lowered, by the part of the error that its change shows.

    Lower ones cost less than higher ones would, and overestimate; the lowest are raised instead.
    The radius in lengths stays, whatever the spacing of the nodes.
    """
    kappa, order, nodes = scheme.upsampling, scheme.expansion_order, scheme.n_theta
    fewer = nodes - 2 if nodes >= 6 else nodes + 2
    return {
        "quadrature": replace(scheme, upsampling=kappa - 1 if kappa > 1 else 2),
        "truncation": replace(scheme, expansion_order=order - 2 if order >= 2 else order + 2),
        "resolution": replace(
            scheme, n_theta=fewer, r_over_h=scheme.r_over_h * fewer / scheme.n_theta
        ),
    }


def model_distance(one: BodyModel, other: BodyModel, degree: int = 3) -> float:
    """Largest relative difference of two body models, in force, torque or free motion.

    Resistances relative to themselves, where both models hold them; the coefficients of one degree
    may all err in one direction and count by their sum, relative to the largest quadratic one, the
    squared radius over which second and third derivatives act. Coefficients above the flow's degree
    do not count.
    """
    f, g = one.faxen, other.faxen
    area = float(np.max(np.abs(f.quadratic)))
    parts = (
        abs(f.linear - g.linear),
        float(np.sum(np.abs(f.quadratic - g.quadratic))) / area,
        float(np.sum(np.abs(f.cubic - g.cubic))) / area,
    )
    motion = max(parts[: max(1, degree)])
    r, s = one.formed_resistance, other.formed_resistance
    if r is None or s is None:
        return motion
    numbers = zip(vars(r).values(), vars(s).values(), strict=True)
    distance = float(motion + max(abs(a / b - 1.0) for a, b in numbers))
    return math.inf if math.isnan(distance) else distance


def adjoint_tail(functional: ModalFunctional) -> float:
    """Last two Legendre moments of the adjoint densities relative to the largest one.

    Moments, which are the coefficients over l + 1/2, are what a flow's own harmonics meet.
    """
    degrees = np.arange(functional.grid.n_theta) + 0.5
    moments = [np.abs(c / degrees) for c in functional.profiles().values()]
    return max(float(np.max(m[:, -2:]) / np.max(m)) for m in moments)


def _rounding(body: _Body, completion: Completion | None, degree: int) -> float:
    """Change of the model when every entry of the rows moves by a rounding error of its sum."""
    grid, spread = body.functional.grid, []
    for double in perturbed_rows(grid, body.scheme, body.rows[0]):
        rows = double, body.rows[1]
        operators = surface_operators(grid.shape, body.scheme, 3, completion, rows)
        perturbed = form_body_model(operators)
        spread.append(model_distance(body.model, perturbed, degree))
    return float(np.max(spread)) + ROUNDING_FLOOR


def perturbed_rows(grid: SurfaceGrid, scheme: Scheme, rows: Array) -> Iterator[Array]:
    """Rows of the double layer whose entries each moved by a rounding error of its sum."""
    rng = np.random.default_rng(0)
    size = _ROUNDING * np.finfo(float).eps * 4.0 * math.pi / math.sqrt(scheme.n_theta)
    for _ in range(_PERTURBATIONS):
        double = rows + size * rng.standard_normal(rows.shape)
        if isinstance(scheme, GradedScheme) and scheme.keep_rigid:
            impose_rigid_motions(grid, independent_rows(grid.shape, scheme.n_theta), double)
        yield double
