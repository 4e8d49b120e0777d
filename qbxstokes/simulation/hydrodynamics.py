"""From a body and a flow to the body model and the provider of free motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.bie.accuracy import (
    AccurateBody,
    RowFormer,
    accurate_body,
    choose_scheme,
    model_distance,
)
from qbxstokes.bie.functional import BodyModel, FaxenCoefficients, Resistance
from qbxstokes.bie.resolution import resolving_nodes
from qbxstokes.bie.rigid import Completion
from qbxstokes.case.running import GRADED_KEYS, Hydrodynamics
from qbxstokes.errors import FlowError, SceneError
from qbxstokes.flows import ChangingFlow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.shape import Revolution, Shape
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.cache import Cache
from qbxstokes.motion.point import PointMotion
from qbxstokes.qbx.operator import (
    GradedScheme,
    Scheme,
    UniformScheme,
    independent_rows,
    layer_rows,
    rigid_defects,
)
from qbxstokes.reference import faxen
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.formed_body import FormedBody
    from qbxstokes.simulation.simulation import Simulation

# GMRES residual over the tolerance asked for, so that the solve is not what limits the accuracy.
_SOLVE_MARGIN = 1e-2
_TIGHTEST_SOLVE = 1e-14
# Share of the rotation below which a body is a thin one, or a flat one: k = 1/8 and 8.
_THIN = 1.0 / 64.0
# Share of the tolerance that the grid of a flow that is not polynomial may take.
_FLOW_SHARE = 0.1


@dataclass(frozen=True)
class Workshop:
    """Who forms the rows of the operators (several ranks perhaps), and where results are kept."""

    form_rows: RowFormer = layer_rows
    cache: Cache = field(default_factory=lambda: Cache(None))


@dataclass
class Hydrodynamic:
    """The body model, what the equations of motion ask at each step, and how it was obtained."""

    model: BodyModel
    provider: Any
    facts: dict[str, Any] = field(default_factory=dict)
    solvers: list[Any] = field(default_factory=list)

    def report(self) -> dict[str, Any]:
        """How it was obtained, in numbers and words: discretisation, solves, estimated error."""
        records = [record for solver in self.solvers for record in solver.records]
        names = {"finest_nodes": "finest", "coarsest_nodes": "coarsest", "neglected": "neglected"}
        told = {key: getattr(self.provider, name, None) for key, name in names.items()}
        return {
            **self.facts,
            "solves": len(records),
            "iterations": sum(record.iterations for record in records),
            "most_iterations": max((record.iterations for record in records), default=0),
            "true_residual": max((record.true_residual for record in records), default=0.0),
            **{key: list(value) for key, value in told.items() if value},
            "error_estimate": self.model.error_estimate,
        }


def form_body(
    body: FormedBody, degree: int, completion: Completion | None
) -> tuple[AccurateBody, list[Any]]:
    """The body model and its functional, from the cache if it has them, and the solvers used.

    degree: of the flow, 1 to 3 (3 for flows that are not polynomial). Raises ConvergenceError where
    rounding forbids a tolerance that somebody asked for.
    """
    shape, section, workshop = body.shape, body.settings, body.workshop
    cache, scheme = workshop.cache, explicit_scheme(section)
    solvers: list[Any] = []
    residual = solver_tolerance(section, shape)
    key = {
        "shape": shape.spec(),
        "degree": degree,
        "tolerance": section.tolerance,
        "side": side_of(section),
        "scheme": None if scheme is None else [section.scheme, asdict(scheme)],
        "completion": completion,
        "residual": residual,
        "preconditioner": section.preconditioner,
    }
    fault = partial(_fault_of_body, shape, degree)
    arrays = cache.load("body", key, fault)
    if arrays is None and completion is None:
        # A body with its resistance serves as well: whether there is one changes no output.
        arrays = cache.load("body", {**key, "completion": "surface"}, fault)
        if arrays is not None:
            del arrays["model_resistance"]
    if arrays is not None:
        return AccurateBody.from_arrays(arrays), []
    found = accurate_body(
        shape,
        section.tolerance,
        scheme,
        side=side_of(section),
        degree=degree,
        strict=body.strict,
        completion=completion,
        solver=solver_factory(section, solvers),
        form_rows=workshop.form_rows,
    )
    cache.store("body", key, found.to_arrays())
    return found, solvers


def _fault_of_body(shape: Shape, degree: int, arrays: Mapping[str, Any]) -> str:
    """What is wrong with a body that was kept: it must follow rigid motions of the fluid.

    Its numbers are those of the closed forms, where its shape has them, within many times the error
    that it states.
    """
    body = AccurateBody.from_arrays(arrays)
    grid = body.functional.on_grid(4)
    identity = np.einsum("anj,bnj->ab", grid.weights, _rigid_motions(grid.points))
    missed = float(np.abs(identity - np.eye(6)).max())
    numbers = [v for v in arrays.values() if np.asarray(v).dtype.kind == "f"]
    finite = all(np.isfinite(values).all() for values in numbers)
    same = body.model.shape == shape
    wrong = np.nan_to_num(true_error(body.model, degree)) if finite and same else np.inf
    bound = max(30.0 * body.model.error_estimate, 1e-8)
    return "" if missed <= bound and wrong <= bound else "does not hold the numbers of this body"


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


def _rigid_motions(points: Array) -> Array:
    """Unit translations and rotations (6, N, 3) at points (N, 3)."""
    turns = np.cross(np.eye(3)[:, None], points)
    return np.concatenate([np.broadcast_to(np.eye(3)[:, None], turns.shape), turns])


def _fault_of_rows(
    shape: Revolution, scheme: Scheme, shapes: Sequence[tuple[int, ...]], arrays: Mapping[str, Any]
) -> str:
    """What is wrong with kept rows of the layers: D psi = 4 pi psi for rigid motions psi."""
    found = [arrays[name] for name in ("double", "single") if name in arrays]
    if [rows.shape for rows in found] != list(shapes) or any(rows.dtype != float for rows in found):
        return "does not hold rows of this operator"
    wanted = independent_rows(shape, scheme.n_theta)
    missed = np.abs(rigid_defects(scheme.grid(shape, 1), wanted, found[0])).max()
    # The uniform scheme has errors of its own, which it is there to show.
    bound = 1e-6 if isinstance(scheme, GradedScheme) else 1.0
    good = missed <= bound * (1.0 + 4.0 * np.pi) and np.isfinite(found[1]).all()
    return "" if good else "does not hold the numbers of this operator"


def solver_factory(section: Hydrodynamics, solvers: list[Any]) -> Callable[[Any, Any], Any]:
    """What makes a GMRES solver of an operator on a grid; each is added to `solvers`."""

    def factory(operator: Any, grid: Any) -> Any:
        from qbxstokes.petsc import session

        session.start()
        from qbxstokes.petsc.gmres import GmresSolver

        residual = solver_tolerance(section, grid.shape)
        solver = GmresSolver(operator, grid, residual, section.preconditioner)
        solvers.append(solver)
        return solver

    return factory


def hydrodynamics_of(
    scene: Simulation, *, pushed: bool = False, degree: int | None = None
) -> Hydrodynamic:
    """The body model of a scene, and what knows the free motion in its flow at each step.

    pushed: with the resistance in any case. degree: of the flows that the model is for, 1 to 3, if
    not that of the scene's own.
    """
    body, flow, section = scene.body, scene.carrier, scene.body.settings
    degree = degree or (3 if flow.degree is None else min(3, max(1, flow.degree)))
    cache, completion = body.workshop.cache, scene.completion(pushed)
    before = cache.found
    formed, solvers = body.formed(degree, completion)
    model = formed.model
    facts = {
        "scheme": section.scheme,
        "completion": completion,
        "gmres_tolerance": solver_tolerance(section, body.shape),
        "cache": "found" if cache.found > before else "formed",
        "n_phi": formed.functional.grid.n_phi,
        **vars(formed.scheme),
    }
    if model.error_parts is not None:
        facts["error_parts"] = dict(vars(model.error_parts))
    found = Hydrodynamic(model, None, facts, list(solvers))
    if scene.recognised is not None:
        facts["recognised"] = scene.recognised.told
    if scene.kind == "every_step":
        found.provider = _solved_motion(scene, formed, completion, found)
    elif scene.kind == "grid":
        found.provider = whole = _grid_motion(scene, formed, facts)
        if section.derivatives:
            found.provider = PointMotion(model, flow, section.derivatives, whole)
    else:
        found.provider = flow if isinstance(flow, ChangingFlow) else flow.polynomial
    return found


def _grid_motion(scene: Simulation, body: AccurateBody, facts: dict[str, Any]) -> Any:
    """The free motion by the functional on a grid; notes the nodes that the flow takes."""
    from qbxstokes.bie.providers import AdaptiveGridMotion, GridMotion, MonitoredGridMotion

    flow, section = scene.carrier, scene.body.settings
    if body.functional.grid.nodes != "cosine" or section.n_phi is not None:
        n_phi = section.n_phi or 2 * body.functional.grid.n_theta
        return GridMotion(body.functional.on_grid(n_phi), flow)
    n_theta, n_phi = _flow_nodes(scene, body, facts)
    start, share = (scene.position[0], scene.quaternion[0]), _FLOW_SHARE * section.tolerance
    if not len(flow.singular_points):
        kind = MonitoredGridMotion
        if getattr(flow, "point_function", None) is not None:
            from qbxstokes.bie.compiled_motion import CompiledMotion as kind
        found = kind(body.functional, flow, share, (n_theta, n_phi))
        found.calibrate(*start)
        return found
    motion = AdaptiveGridMotion(body.functional, flow, share)
    motion.calibrate(*start, n_theta)
    return motion


def _flow_nodes(scene: Simulation, body: AccurateBody, facts: dict[str, Any]) -> tuple[int, int]:
    """Nodes that resolve the flow on the surface at the start; notes the error they leave."""
    turn, centre = rotation.matrix(scene.quaternion[0]), scene.position[0]

    def velocity(points: Any) -> Any:
        return scene.carrier.velocity(centre + points @ turn.T, 0.0) @ turn

    share = _FLOW_SHARE * scene.body.tolerance
    try:
        n_theta, n_phi, error = resolving_nodes(body.functional, velocity, share)
    except FlowError as refusal:
        raise SceneError("flow", str(refusal), "move the body away") from None
    facts |= {"flow_nodes": [n_theta, n_phi], "flow_error": error}
    return n_theta, n_phi


def _solved_motion(
    scene: Simulation,
    body: AccurateBody,
    completion: Completion | None,
    found: Hydrodynamic,
) -> Any:
    """The free motion by a solve at every step."""
    from qbxstokes.bie.operators import surface_operators
    from qbxstokes.bie.providers import SolveMotion

    scheme: Scheme = body.scheme
    flow, own, section = scene.carrier, scene.body.shape, scene.body.settings
    workshop = scene.body.workshop
    n_phi, degree = section.n_phi, flow.degree
    if isinstance(scheme, GradedScheme) and degree is None:
        n_theta, needed = _flow_nodes(scene, body, found.facts)
        n_phi = n_phi or needed | 1
        if explicit_scheme(section) is None and n_theta > scheme.n_theta:
            scheme = choose_scheme(section.tolerance, n_theta, scheme.side)
    # A flow of degree d excites modes up to d + 1, which 2 d + 4 nodes keep from aliasing. An
    # odd number has no mode of half its own, which the preconditioner cannot invert.
    n_phi = n_phi or (2 * scheme.n_theta if degree is None else 2 * degree + 4) | 1
    found.facts |= {**vars(scheme), "n_phi": n_phi}
    spread, n_modes = completion == "surface", n_phi // 2 + 1
    key = {
        "shape": own.spec(),
        "scheme": [section.scheme, asdict(scheme)],
        "n_modes": n_modes,
        "single": spread,
    }
    wanted = independent_rows(own, scheme.n_theta)
    shape = (len(wanted), n_modes, 3, 3, scheme.n_theta)
    shapes = [shape, shape if spread else (len(wanted), 0, 3, 3, scheme.n_theta)]
    fault = partial(_fault_of_rows, own, scheme, shapes)
    arrays = workshop.cache.load("operator", key, fault)
    if arrays is None:
        rows = workshop.form_rows(own, scheme, n_modes, wanted, spread)
        workshop.cache.store("operator", key, {"double": rows[0], "single": rows[1]})
    else:
        rows = arrays["double"], arrays["single"]
    operators = surface_operators(own, scheme, n_phi, completion, rows)
    return SolveMotion(operators, flow, solver_factory(section, found.solvers))


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


def solver_tolerance(section: Hydrodynamics, shape: Shape) -> float:
    """Relative residual that GMRES has to reach.

    The period of a thin or flat body follows from what a shear along it leaves of its rotation,
    k^2 of the whole: its law is solved to as much less.
    """
    if section.gmres_tolerance is not None:
        return float(section.gmres_tolerance)
    k = shape.effective_ratio or 1.0
    left = min(k, 1.0 / k) ** 2
    share = left if left < _THIN else 1.0
    return max(_SOLVE_MARGIN * section.tolerance * share, _TIGHTEST_SOLVE)
