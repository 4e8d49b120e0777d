"""QBX parameters: orientations, nodes of the density, expansion order, radius and upsampling."""

from __future__ import annotations

import math
import time
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.app.study import discretise, simulate
from qbxstokes.app.study.linear_shear import fill
from qbxstokes.bie.accuracy import choose_scheme, model_distance
from qbxstokes.bie.exact import true_error
from qbxstokes.bie.operators import surface_operators
from qbxstokes.bie.providers import SolveMotion
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table
from qbxstokes.qbx.operator import GradedScheme, Scheme, UniformScheme
from qbxstokes.reference import faxen

Array = NDArray[np.float64]

_N_THETA = 20
_MAP_NODES = 14
_SOURCES = 240  # polar nodes of the upsampled grid where the nodes of the density vary
_PLACE = np.array([[0.3, 2.0, -0.5]])


def blocks(full: bool) -> list[dict[str, Any]]:
    """Orientations by scheme, nodes, and a column of the map per block."""
    found: list[dict[str, Any]] = []
    count = 100 if full else 6
    for k in (0.5, 2.0):
        for name in ("uniform", "uniform fine", "graded 1e-6", "graded 1e-10"):
            found.append({"k": k, "scheme": name, "orientations": count})
        nodes = (4, 6, 8, 10, 14, 20) if full else (4, 8)
        found += [{"k": k, "nodes": n} for n in nodes]
    orders = (2, 4, 6, 9, 13, 18, 24) if full else (4, 10)
    parts = (0.15, 0.3, 0.5, 0.7, 1.0, 1.2) if full else (0.5, 1.2)
    for part in parts:
        ratio = round(part * discretise.largest_ratio(0.5, _MAP_NODES), 4)
        for order in orders:
            found.append({"k": 0.5, "r_over_h": ratio, "order": order, "upsamplings": (4, 8, 16)})
    return found


def compute(
    k: float,
    scheme: str = "",
    orientations: int = 0,
    nodes: int = 0,
    r_over_h: float = 0.0,
    order: int = 0,
    upsamplings: tuple[int, ...] = (),
) -> list[dict[str, Any]]:
    """Rows of one of the three parts."""
    if orientations:
        return _orientations(k, scheme, orientations)
    return _nodes(k, nodes) if nodes else _map(k, r_over_h, order, upsamplings)


def _scheme(k: float, name: str) -> Scheme:
    """A scheme by the name that the tables give it."""
    if name.startswith("graded"):
        return choose_scheme(float(name.split()[1]))
    ratio = 0.8 * discretise.largest_ratio(k, _N_THETA)
    order, upsampling = (10, 10) if name == "uniform" else (24, 20)
    return discretise.uniform(k, _N_THETA, order, ratio, upsampling)


def _scene() -> Any:
    """Shear with a paraboloid on top: every term of the laws up to second order counts."""
    hessian = np.zeros((3, 3, 3))
    hessian[0, 1, 1] = hessian[0, 2, 2] = 0.5
    gradient = [[0.2, 1.0, 0.0], [0.0, -0.1, 0.3], [0.1, 0.0, -0.1]]
    return simulate.polynomial(type="polynomial", gradient=gradient, hessian=hessian.tolist())


def _orientations(k: float, name: str, count: int) -> list[dict[str, Any]]:
    """Errors of a held body's force and torque and of a free body's velocities."""
    scheme, flow = _scheme(k, name), _scene()
    completion = "surface" if isinstance(scheme, GradedScheme) else "point"
    n_phi = 9  # odd, and beyond the modes that a flow of degree 2 excites
    begin = time.perf_counter()
    operators = surface_operators(Spheroid(k), scheme, n_phi, completion)  # type: ignore[arg-type]
    motion = SolveMotion(operators, flow)
    q = rotation.random_quaternions(count, np.random.default_rng(7))
    x = np.repeat(_PLACE, count, axis=0)
    motion.free_motion(0.0, x[:1], q[:1])
    formed = time.perf_counter() - begin
    still = np.zeros((count, 3))
    begin = time.perf_counter()
    u, omega = motion.free_motion(0.0, x, q)
    force, torque = motion.force_torque(0.0, x, q, still, still)
    spent = (time.perf_counter() - begin) / (2 * count)
    d = rotation.axis(q)
    exact_u, exact_omega = faxen.free_motion_polynomial(k, d, *flow.derivatives(x)[:4])
    across, along, turning, spinning = faxen.resistance(k)
    exact_force = across * exact_u + (along - across) * d * np.sum(d * exact_u, 1, keepdims=True)
    exact_torque = turning * exact_omega + (spinning - turning) * d * np.sum(
        d * exact_omega, 1, keepdims=True
    )
    angle = np.degrees(np.arccos(np.abs(d[:, 2])))
    errors = {
        "force_error": _relative(force, exact_force),
        "torque_error": _relative(torque, exact_torque),
        "velocity_error": _relative(u, exact_u),
        "angular_velocity_error": _relative(omega, exact_omega),
    }
    return [
        {
            "table": "orientations",
            "aspect_ratio": k,
            "scheme": name,
            "tilt": float(angle[i]),
            **{label: float(values[i]) for label, values in errors.items()},
            "set_up": formed,
            "solve": spent,
        }
        for i in range(count)
    ]


def _relative(values: Array, exact: Array) -> Array:
    size = np.linalg.norm(exact, axis=1)
    return np.asarray(np.linalg.norm(values - exact, axis=1) / size)


def _nodes(k: float, nodes: int) -> list[dict[str, Any]]:
    """Error of the density at its nodes and of the model, with quadrature that does not change."""
    flow = _scene()
    radius = 0.95 * min(k * k, 1.0 / k)
    n_phi = 9
    monomials, coefficients = _exact_density(k)
    rows = []
    for name in ("uniform", "graded"):
        if name == "uniform":
            # The same upsampled grid for every number of nodes, dense enough in azimuth as well.
            upsampling = _SOURCES // nodes
            around = max(8, 2 * math.ceil(0.5 * max(k, 1.0) * _SOURCES / upsampling))
            ratio = radius * nodes / (2.0 * np.pi)
            scheme: Scheme = UniformScheme(nodes, around, 18, ratio, upsampling, "average")
        else:
            scheme = GradedScheme(nodes, 26, 0.3, 18, 0.7)
        begin = time.perf_counter()
        operators = surface_operators(Spheroid(k), scheme, n_phi)
        points = operators.grid.points
        density = operators.mobility.inverse.apply(-flow.velocity(points + _PLACE[0]))
        spent = time.perf_counter() - begin
        exact = monomials(points) @ coefficients
        _, model, _ = discretise.formed(k, scheme)
        rows.append(
            {
                "table": "density_nodes",
                "aspect_ratio": k,
                "scheme": name,
                "n_theta": nodes,
                "density_error": float(np.abs(density - exact).max() / np.abs(exact).max()),
                "motion_error": true_error(model),
                "time": spent,
            }
        )
    return rows


@lru_cache
def _exact_density(k: float) -> tuple[Any, Array]:
    """The density of the scene as a polynomial of degree 3, fitted to a resolved solution."""

    def monomials(points: Array) -> Array:
        x, y, z = points.T
        powers = [(a, b, c) for a in range(4) for b in range(4) for c in range(4) if a + b + c < 4]
        return np.stack([x**a * y**b * z**c for a, b, c in powers], axis=-1)

    scheme = GradedScheme(28, 32, 0.3, 22, 0.6)
    operators = surface_operators(Spheroid(k), scheme, 9)
    points = operators.grid.points
    density = operators.mobility.inverse.apply(-_scene().velocity(points + _PLACE[0]))
    fitted, *_ = np.linalg.lstsq(monomials(points), density, rcond=1e-12)
    return monomials, fitted


def _map(k: float, r_over_h: float, order: int, upsamplings: tuple[int, ...]) -> Any:
    """Error, its truncation and its quadrature part per upsampling; none where forbidden."""
    rows: list[dict[str, Any]] = [
        {
            "table": "qbx_map",
            "aspect_ratio": k,
            "upsampling": upsampling,
            "r_over_h": r_over_h,
            "expansion_order": order,
            "forbidden": r_over_h > discretise.largest_ratio(k, _MAP_NODES),
        }
        for upsampling in upsamplings
    ]
    if rows[0]["forbidden"]:
        return rows
    schemes = [discretise.uniform(k, _MAP_NODES, order, r_over_h, u) for u in upsamplings]
    _, resolved, _ = discretise.formed(k, discretise.Resolved.of(schemes[0], Spheroid(k)))
    for row, scheme in zip(rows, schemes, strict=True):
        _, model, spent = discretise.formed(k, scheme)
        row |= {
            "error": true_error(model),
            "truncation": true_error(resolved),
            "quadrature": model_distance(model, resolved),
            "time": spent,
        }
    return rows


_K = Column("aspect_ratio", "", "equatorial over polar radius", "g", "k")


def tables(rows: list[dict[str, Any]]) -> list[Table]:
    """Orientations (each and in sum), nodes of the density, and the map of parameters."""
    names = ("force_error", "torque_error", "velocity_error", "angular_velocity_error")
    each = Table(
        "orientations",
        "Errors in random orientations, held and free, in a quadratic flow",
        (
            _K,
            Column("scheme", "", "quadrature and its parameters"),
            Column("tilt", "deg", "angle of the axis from the vorticity", ".2f"),
            *(Column(name, "", "relative", ".2e") for name in names),
            Column("set_up", "s", "wall time of the operators", ".3g"),
            Column("solve", "s", "wall time of a solve", ".2g"),
        ),
        plot={"x": "tilt", "y": "velocity_error", "by": "scheme",
              "scale": "semilogy", "points": True},
    )  # fmt: skip
    nodes = Table(
        "density_nodes",
        "Convergence of the density with n_theta at fixed quadrature",
        (
            _K,
            Column("scheme", "", f"uniform: {_SOURCES} polar source nodes, p = 18; graded: p = 26"),
            Column("n_theta", "", "polar nodes of the density", "d"),
            Column("density_error", "", "largest at the nodes, relative", ".2e"),
            Column("motion_error", "", "of resistance and free motion", ".2e"),
            Column("time", "s", "wall time of the operators and a solve", ".3g"),
        ),
        notes=[
            "The density of this flow is a polynomial of degree 3, which four nodes hold. What "
            "falls with the nodes of the graded scheme is a rigid motion in the density, from the "
            "quadrature of the projections on rigid motions; no force, torque or velocity feels "
            "it. The uniform scheme ends at the error of its quadrature and truncation."
        ],
        plot={"x": "n_theta", "y": "density_error", "by": ["aspect_ratio", "scheme"],
              "scale": "semilogy"},
    )  # fmt: skip
    parameters = Table(
        "qbx_map",
        f"Uniform scheme, k = 1/2, n_theta = {_MAP_NODES}: error by order, radius, upsampling",
        (
            _K,
            Column("upsampling", "", "kappa", "d"),
            Column("r_over_h", "", "expansion radius over spacing", ".3f", "r/h"),
            Column("expansion_order", "", "p", "d"),
            Column("error", "", "of resistance and free motion", ".2e"),
            Column("truncation", "", "the same with exact quadrature", ".2e"),
            Column("quadrature", "", "change when the quadrature is made exact", ".2e"),
            Column("time", "s", "wall time", ".3g"),
            Column("forbidden", "", "the ball crosses the surface"),
        ),
        plot={"x": "r_over_h", "y": "expansion_order", "value": "error", "by": "upsampling",
              "mark": "minimum"},
    )  # fmt: skip
    fill([each, nodes, parameters], rows)
    return [each, _summary(each, names), nodes, parameters]


def _summary(each: Table, names: tuple[str, ...]) -> Table:
    """Median and largest error over the orientations."""
    made = Table(
        "orientation_summary",
        "Errors over random orientations",
        (
            _K,
            Column("scheme", "", "uniform: p = 10, kappa = 10; fine: p = 24, kappa = 20"),
            *(
                Column(f"{part}_{name}", "", f"{part} over the orientations", ".1e")
                for name in names
                for part in ("median", "largest")
            ),
            Column("set_up", "s", "wall time of the operators", ".3g"),
            Column("solve", "s", "wall time of a solve", ".2g"),
        ),
    )
    for k in sorted(set(each["aspect_ratio"].tolist())):
        for scheme in dict.fromkeys(each["scheme"].tolist()):
            chosen = (each["aspect_ratio"] == k) & (each["scheme"] == scheme)
            if not chosen.any():
                continue
            row: dict[str, Any] = {"aspect_ratio": k, "scheme": scheme}
            for name in names:
                row[f"median_{name}"] = float(np.median(each[name][chosen]))
                row[f"largest_{name}"] = float(np.max(each[name][chosen]))
            for name in ("set_up", "solve"):
                row[name] = float(each[name][chosen][0])
            made.add(**row)
    return made


def _orientations_figure(made: dict[str, Table]) -> Any:
    """Errors over orientations, and over the nodes of the density."""
    from qbxstokes.plots import style

    each, nodes = made["orientations"], made["density_nodes"]
    figure = style.new_figure(style.PAGE, 3.1)
    panels = figure.subplots(1, 3)
    schemes = list(dict.fromkeys(each["scheme"].tolist()))
    for panel, k in zip(panels[:2], (0.5, 2.0), strict=True):
        for index, scheme in enumerate(schemes):
            color, _, marker = style.LINES[index]
            chosen = (each["aspect_ratio"] == k) & (each["scheme"] == scheme)
            panel.plot(each["tilt"][chosen], each["force_error"][chosen], marker, color=color,
                       markersize=2.5, label=scheme)  # fmt: skip
            panel.plot(each["tilt"][chosen], each["angular_velocity_error"][chosen], marker,
                       color=color, markersize=2.5, markerfacecolor="none")  # fmt: skip
        panel.set_yscale("log")
        panel.set_ylim(1e-17, 1e-2)
        panel.set_xlabel("tilt of the axis (deg)")
        panel.set_title(f"$k={k:g}$", loc="left")
    panels[0].set_ylabel("relative error")
    for text, face in (("force, held", style.BLACK), ("angular velocity, free", "none")):
        panels[0].plot([], [], "o", color=style.BLACK, markerfacecolor=face, markersize=2.5,
                       label=text)  # fmt: skip
    index = 0
    for k in (0.5, 2.0):
        for scheme in ("uniform", "graded"):
            chosen = (nodes["aspect_ratio"] == k) & (nodes["scheme"] == scheme)
            panels[2].plot(nodes["n_theta"][chosen], nodes["density_error"][chosen],
                           label=f"$k={k:g}$, {scheme}",
                           **style.line_style(index, markers=True))  # fmt: skip
            index += 1
    panels[2].set_yscale("log")
    panels[2].set_xlabel(r"$n_\vartheta$")
    panels[2].set_ylabel("error of the density")
    panels[2].legend(fontsize=7)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncol=6,
                  handlelength=1.0)  # fmt: skip
    style.letter_panels(list(panels))
    return figure


def _valley_figure(made: dict[str, Table]) -> Any:
    """The valley between truncation and quadrature, a panel per upsampling."""
    from qbxstokes.plots import style

    parameters = made["qbx_map"]
    figure = style.new_figure(style.PAGE, 2.7)
    panels = figure.subplots(1, 3, sharey=True)
    for panel, upsampling in zip(panels, sorted(set(parameters["upsampling"].tolist())),
                                 strict=False):  # fmt: skip
        inside = (parameters["upsampling"] == upsampling) & np.isfinite(parameters["error"])
        ratios = sorted(set(parameters["r_over_h"][inside].tolist()))
        for index, ratio in enumerate(ratios[:1] + ratios[max(1, len(ratios) - 3) :]):
            chosen = inside & (parameters["r_over_h"] == ratio)
            color = style.LINES[index][0]
            p = parameters["expansion_order"][chosen]
            panel.plot(p, parameters["error"][chosen], "o", color=color, markersize=3,
                       label=f"{ratio:.2f}")  # fmt: skip
            panel.plot(p, parameters["truncation"][chosen], color=color)
            panel.plot(p, parameters["quadrature"][chosen], color=color,
                       linestyle=(0, (3, 1.5)))  # fmt: skip
        panel.set_yscale("log")
        panel.set_ylim(1e-13, 10.0)
        panel.set_xlabel("expansion order $p$")
        panel.set_title(rf"$\kappa = {upsampling}$", loc="left")
    panels[0].set_ylabel("relative error")
    for text, look in (("truncation", "solid"), ("quadrature", (0, (3, 1.5)))):
        panels[0].plot([], [], color=style.BLACK, linestyle=look, label=text)
    panels[0].plot([], [], "o", color=style.BLACK, markersize=3, label="total")
    figure.legend(*panels[0].get_legend_handles_labels(), title="$r/h$",
                  loc="outside right center")  # fmt: skip
    style.letter_panels(list(panels))
    return figure


def _map_figure(made: dict[str, Table]) -> Any:
    """Error over radius and order, a panel per upsampling, with a line per decade."""
    from qbxstokes.plots import style

    parameters = made["qbx_map"]
    figure = style.new_figure(style.PAGE, 2.5)
    upsamplings = sorted(set(parameters["upsampling"].tolist()))
    panels = figure.subplots(1, len(upsamplings), sharey=True, squeeze=False)[0]
    radii = np.unique(parameters["r_over_h"])
    orders = np.unique(parameters["expansion_order"])
    mesh: Any = None
    for panel, upsampling in zip(panels, upsamplings, strict=True):
        errors = np.full((len(orders), len(radii)), np.nan)
        chosen = (parameters["upsampling"] == upsampling) & ~parameters["forbidden"].astype(bool)
        row = np.searchsorted(orders, parameters["expansion_order"][chosen])
        column = np.searchsorted(radii, parameters["r_over_h"][chosen])
        errors[row, column] = parameters["error"][chosen]
        mesh = panel.pcolormesh(
            radii, orders, errors, norm="log", vmin=1e-5, vmax=10.0, shading="nearest"
        )
        if len(orders) > 2:
            levels = 10.0 ** np.arange(-4.0, 1.0)
            panel.contour(radii, orders, errors, levels, colors="white", linewidths=0.7)
        best = np.unravel_index(np.nanargmin(errors), errors.shape)
        panel.plot(radii[best[1]], orders[best[0]], "*", color="white", markersize=9,
                   markeredgecolor=style.BLACK)  # fmt: skip
        allowed = radii[np.isfinite(errors).any(axis=0)][-1]
        panel.axvspan(0.5 * (allowed + radii[-1]), panel.get_xlim()[1], facecolor="#f2f2f2",
                      edgecolor=style.GREY, hatch="////", linewidth=0.0)  # fmt: skip
        panel.set_xlabel("$r/h$")
        panel.set_title(rf"$\kappa = {upsampling}$", loc="left")
    panels[0].set_ylabel("expansion order $p$")
    figure.colorbar(mesh, ax=list(panels), label="relative error", pad=0.01)
    style.letter_panels(list(panels))
    return figure


FIGURES = {
    "orientations": _orientations_figure,
    "valley": _valley_figure,
    "map": _map_figure,
}
