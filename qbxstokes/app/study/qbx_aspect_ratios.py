"""QBX over aspect ratios: fixed and automatic parameters, and those to recommend."""

from __future__ import annotations

from typing import Any

import numpy as np

from qbxstokes.app.study import discretise
from qbxstokes.app.study.linear_shear import fill
from qbxstokes.bie.accuracy import AccurateBody, accurate_body, choose_scheme
from qbxstokes.bie.exact import true_error
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table
from qbxstokes.qbx.operator import GradedScheme

RATIOS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
TOLERANCES = (1e-4, 1e-7, 1e-10)
# Dearest trials of the uniform scheme, as `discretise.cost` counts: to compare, and to search.
_DEAREST, _DEAREST_OF_MANY = 1e8, 2.5e7


def blocks(full: bool) -> list[dict[str, Any]]:
    """Two blocks per aspect ratio: errors, and parameters for tolerances."""
    ratios = RATIOS if full else (0.2, 2.0)
    tolerances = TOLERANCES if full else (1e-4,)
    found: list[dict[str, Any]] = [{"k": k} for k in ratios]
    return found + [{"k": k, "tolerances": tolerances} for k in ratios]


def compute(k: float, tolerances: tuple[float, ...] = ()) -> list[dict[str, Any]]:
    """Errors at fixed and automatic parameters, or the cheapest parameters for tolerances."""
    # The first expansion in a process waits for its compiler's cache; no timing shall.
    discretise.formed(1.0, GradedScheme(4, 4, 0.3, 6))
    discretise.formed(1.0, discretise.uniform(1.0, 6, 4, 0.3, 2))
    if not tolerances:
        return _errors(k)
    trials = _uniform_trials(k)
    return [_recommended(k, tolerance, trials) for tolerance in tolerances]


def _errors(k: float) -> list[dict[str, Any]]:
    rows = []
    n_theta = 20
    ratio = discretise.largest_ratio(k, n_theta)
    # Fixed: what serves k = 1/2 well. Adapted: the radius alone follows the body.
    fixed_ratio = 0.5 * discretise.largest_ratio(0.5, n_theta)
    trials: list[tuple[str, Any]] = [
        ("uniform, fixed", discretise.uniform(k, n_theta, 14, fixed_ratio, 15)),
        ("uniform, radius adapted", discretise.uniform(k, n_theta, 14, 0.5 * ratio, 15)),
        ("graded, fixed", choose_scheme(1e-10)),
        ("graded, automatic", None),
    ]
    for name, scheme in trials:
        row: dict[str, Any] = {"table": "aspect_ratios", "aspect_ratio": k, "scheme": name}
        if scheme is None:
            model, spent, estimate = _automatic(k, 1e-10)[1:]
            row |= {"error": true_error(model), "estimate": estimate, "time": spent}
        elif isinstance(scheme, GradedScheme) or (
            scheme.r_over_h <= ratio and discretise.cost(scheme) <= _DEAREST
        ):
            _, model, spent = discretise.formed(k, scheme)
            row |= {"error": true_error(model), "time": spent}
        rows.append(row)
    return rows


def _automatic(k: float, tolerance: float) -> tuple[Any, Any, float, float]:
    """Scheme, model, wall time and estimate of the automatic choice."""
    import time

    begin = time.perf_counter()
    body: AccurateBody = accurate_body(Spheroid(k), tolerance, strict=False)
    spent = time.perf_counter() - begin
    return body.scheme, body.model, spent, body.model.error_estimate


def _recommended(k: float, tolerance: float, trials: list[dict[str, Any]]) -> dict[str, Any]:
    scheme, model, spent, estimate = _automatic(k, tolerance)
    _, _, alone = discretise.formed(k, scheme)
    row: dict[str, Any] = {
        "table": "recommended",
        "aspect_ratio": k,
        "tolerance": tolerance,
        "n_theta": scheme.n_theta,
        "expansion_order": scheme.expansion_order,
        "radius_factor": scheme.radius_factor,
        "panel_order": scheme.panel_order,
        "error": true_error(model),
        "estimate": estimate,
        "time": alone,
        "time_with_estimate": spent,
    }
    good = [trial for trial in trials if trial["uniform_error"] <= tolerance]
    return row | min(good, key=lambda trial: trial["uniform_time"], default={})


def _uniform_trials(k: float) -> list[dict[str, Any]]:
    """Error and time of a family of uniform schemes that are not too dear."""
    found = []
    for n_theta in (8, 16):
        for upsampling in (8, 16):
            for order in (6, 12, 20):
                for part in (0.4, 1.0):
                    ratio = part * discretise.largest_ratio(k, n_theta) * (1.0 - 1e-12)
                    scheme = discretise.uniform(k, n_theta, order, ratio, upsampling)
                    if discretise.cost(scheme) > _DEAREST_OF_MANY:
                        continue
                    _, model, spent = discretise.formed(k, scheme)
                    found.append(
                        {
                            "uniform_n_theta": n_theta,
                            "uniform_order": order,
                            "uniform_radius": part,
                            "uniform_upsampling": upsampling,
                            "uniform_error": true_error(model),
                            "uniform_time": spent,
                        }
                    )
    return found


def tables(rows: list[dict[str, Any]]) -> list[Table]:
    """Errors over the aspect ratio, and recommended parameters."""
    k = Column("aspect_ratio", "", "equatorial over polar radius", "g", "k")
    errors = Table(
        "aspect_ratios",
        "Errors over aspect ratios at fixed and at automatic parameters",
        (
            k,
            Column("scheme", "", "quadrature and choice of its parameters"),
            Column("error", "", "of resistance and free motion", ".1e"),
            Column("estimate", "", "what the program says of it", ".1e"),
            Column("time", "s", "wall time, automatic: with the estimate", ".2g"),
        ),
        notes=[
            "Uniform: n_theta = 20, p = 14, kappa = 15, r/h half of the largest for k = 1/2, or "
            "for the body; no error where the expansion balls would cross the surface, or the "
            "upsampled grid has become too large to try."
        ],
        plot={"x": "aspect_ratio", "y": "error", "by": "scheme", "scale": "loglog"},
    )
    parameters = Table(
        "recommended",
        "Parameters for an aspect ratio and a tolerance, with the time of the set-up",
        (
            k,
            Column("tolerance", "", "asked for", ".0e"),
            Column("n_theta", "", "polar nodes (graded)", "d"),
            Column("expansion_order", "", "order (graded)", "d", "p"),
            Column("radius_factor", "", "radius over the admissible one (graded)", "g"),
            Column("panel_order", "", "nodes per panel side (graded)", "d"),
            Column("error", "", "true error (graded)", ".0e"),
            Column("estimate", "", "estimated error (graded)", ".0e"),
            Column("time", "s", "set-up (graded)", ".2g"),
            Column("time_with_estimate", "s", "set-up and estimate (graded)", ".2g"),
            Column("uniform_n_theta", "", "polar nodes (uniform)", "d"),
            Column("uniform_order", "", "order (uniform)", "d", "uniform p"),
            Column("uniform_radius", "", "r/h over its largest (uniform)", "g"),
            Column("uniform_upsampling", "", "kappa (uniform)", "d"),
            Column("uniform_error", "", "true error (uniform)", ".0e"),
            Column("uniform_time", "s", "set-up (uniform)", ".2g"),
        ),
        notes=["No numbers for the uniform scheme: none of those tried met the tolerance."],
        plot={"x": "aspect_ratio", "y": "time", "by": "tolerance", "scale": "loglog"},
    )
    return fill([errors, parameters], rows)


def _figure(made: dict[str, Table]) -> Any:
    """Error over the aspect ratio, and set-up time for a tolerance by both schemes."""
    from qbxstokes.plots import style

    errors, best = made["aspect_ratios"], made["recommended"]
    figure = style.new_figure(style.PAGE, 2.9)
    panels = figure.subplots(1, 2)
    for index, scheme in enumerate(dict.fromkeys(errors["scheme"].tolist())):
        chosen = errors["scheme"] == scheme
        panels[0].plot(errors["aspect_ratio"][chosen], errors["error"][chosen], label=scheme,
                       **style.line_style(index, markers=True))  # fmt: skip
    for index, tolerance in enumerate(sorted(set(best["tolerance"].tolist()), reverse=True)):
        chosen = best["tolerance"] == tolerance
        color, _, marker = style.LINES[index]
        panels[1].plot(best["aspect_ratio"][chosen], best["time"][chosen], marker=marker,
                       color=color, label=f"graded, {_power(tolerance)}")  # fmt: skip
        if np.isfinite(best["uniform_time"][chosen]).any():
            panels[1].plot(best["aspect_ratio"][chosen], best["uniform_time"][chosen],
                           marker=marker, color=color, markerfacecolor="white",
                           linestyle=(0, (3, 1.5)),
                           label=f"uniform, {_power(tolerance)}")  # fmt: skip
    for panel, text in zip(panels, ("relative error", "set-up time (s)"), strict=True):
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_xlabel("aspect ratio $k$")
        panel.set_ylabel(text)
        panel.legend(fontsize=7)
    panels[0].set_ylim(1e-15, 1e2)
    panels[1].set_ylim(top=30.0 * np.nanmax(best["time"]))
    style.letter_panels(list(panels))
    return figure


def _power(tolerance: float) -> str:
    return f"$10^{{{round(np.log10(tolerance))}}}$"


FIGURES = {"aspect_ratios": _figure}
