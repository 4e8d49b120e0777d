"""Drift towards higher shear: speed against St, shape, distance and profile, and its causes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.app.study import simulate
from qbxstokes.app.study.linear_shear import fill
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.io.tables import Column, Table
from qbxstokes.motion.equations import Inertia
from qbxstokes.reference import heavy, lamb
from qbxstokes.reference.inertial import volume

Array = NDArray[np.float64]

HALF_TURNS = 4
FAR = 16.0  # distance from the axis at which the curvature is weak
# A drift below this part of K is rounding.
ZERO = 1e-11
# Aspect ratios for which the drift is drawn with and without inertia of the rotation.
_COMPARED = (0.1, 0.5, 5.0)


def blocks(full: bool) -> list[dict[str, Any]]:
    """Drift against St by parts, against distance and curvature, on orbits; orbit drift; theory."""
    found: list[dict[str, Any]] = []
    ratios = (0.1, 0.2, 0.5, 0.8, 1.0, 1.25, 2.0, 5.0) if full else (0.5, 1.0, 2.0)
    stokes = np.geomspace(0.1, 1000.0, 9) if full else np.array([1.0, 30.0])
    for k in ratios:
        for parts in ("both", "translation"):
            found += [
                {"k": k, "stokes_numbers": group, "parts": parts}
                for group in simulate.decades([float(f"{s:.4g}") for s in stokes], 4.0)
            ]
        few = [1.0, 10.0] if full else [10.0]
        found.append({"k": k, "stokes_numbers": few, "parts": "rotation"})
    distances = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0) if full else (4.0, 16.0)
    for k, light in ((0.5, 10.0), (2.0, 1.0)):
        found += [
            {"k": k, "stokes_numbers": [light, 10.0 * light], "parts": "both", "distance": d}
            for d in distances
            if d != FAR or not full
        ]
        for profile in ("paraboloid", "plane"):
            found.append({"k": k, "profile": profile, "constants": [0.3, 1.0, 3.0, 10.0, np.inf]})
        found += [{"k": k, "local": d, "stokes": light} for d in distances]
    ends = [float(stokes[0]), float(stokes[-1])]
    for k in ratios:
        if k != 1.0:
            found.append({"k": k, "maximum": True})
            found += [
                {"k": k, "curve": ends, "points": 80 if full else 10, "parts": parts}
                for parts in (("both", "translation") if k in _COMPARED else ("both",))
            ]
    return found


def compute(
    k: float,
    stokes_numbers: list[float] | None = None,
    parts: Inertia = "both",
    distance: float = FAR,
    profile: str | None = None,
    constants: list[float] | None = None,
    local: float | None = None,
    stokes: float = 0.0,
    maximum: bool = False,
    curve: list[float] | None = None,
    points: int = 0,
) -> list[dict[str, Any]]:
    """Mean velocity across the stream of tumbling bodies, on orbits; drift of orbits; theory."""
    if stokes_numbers is not None:
        return _tumbling(k, stokes_numbers, parts, distance)
    if profile is not None:
        assert constants is not None
        return _orbits(k, profile, constants)
    if maximum:
        return _maximum(k)
    if curve is not None:
        return _curve(k, np.geomspace(curve[0], curve[1], points), parts)
    assert local is not None
    return _local(k, local, stokes)


def _flow(distance: float, profile: str = "paraboloid") -> Any:
    """Shear rate 1 and curvature K = 1/(2 distance) at x2 = distance."""
    curvature = 0.5 / distance
    if profile == "paraboloid":
        return simulate.polynomial(type="paraboloid", curvature=curvature)
    hessian = np.zeros((3, 3, 3))
    hessian[0, 1, 1] = 2.0 * curvature
    return simulate.polynomial(type="polynomial", hessian=hessian.tolist())


def _tumbling(
    k: float, stokes_numbers: list[float], parts: Inertia, distance: float
) -> list[dict[str, Any]]:
    curvature = 0.5 / distance
    axis = np.tile(simulate.orbit_axes(k, np.inf), (len(stokes_numbers), 1))
    found = simulate.measure(
        k, _flow(distance), stokes_numbers, axis, HALF_TURNS, (0.0, distance, 0.0), parts
    )
    rows = []
    for i, st in enumerate(stokes_numbers):
        drift = float(found.values["velocity_2"][i]) / curvature
        rate = float(found.values["position_2"][i]) / distance
        rows.append(
            {
                "table": "lateral_drift",
                "aspect_ratio": k,
                "stokes_number": st,
                "inertia": parts,
                "distance": distance,
                "curvature": curvature,
                "drift": drift,
                "uncertainty": float(found.errors["velocity_2"][i]) / curvature,
                "local_rate": rate,
                "theory": heavy.drift(k, st * rate, parts),
                "small": st * heavy.small_stokes_drift(k) if parts != "rotation" else 0.0,
                "passed": abs(drift) < ZERO if parts == "rotation" or k == 1.0 else None,
            }
        )
    return rows


def orbit_theory(k: float, constant: float, profile: str) -> float:
    """Drift over K St on a Jeffery orbit for St -> 0: U varies as 1 - d1^2, or as d2^2."""
    if profile == "paraboloid":
        return heavy.small_stokes_drift_on_orbit(k, constant)
    d, g = heavy.jeffery_orbit(k, constant)
    across, along = lamb.translation_resistance(k)
    lag = float(np.mean(d[:, 0] * d[:, 1] * 2.0 * d[:, 1] * g[:, 1]))
    return -volume(k) * (1.0 / along - 1.0 / across) * (1.0 - k * k) / 3.0 * lag


def _orbits(k: float, profile: str, constants: list[float]) -> list[dict[str, Any]]:
    """Translational inertia alone keeps the orbits: the drift on each of them, light bodies."""
    stokes = 0.02 * heavy.relaxation_rates(k)[1]
    axis = simulate.orbit_axes(k, constants)
    found = simulate.measure(
        k, _flow(FAR, profile), stokes, axis, HALF_TURNS, (0.0, FAR, 0.0), "translation"
    )
    scale = stokes * 0.5 / FAR
    return [
        {
            "table": "drift_on_orbits",
            "aspect_ratio": k,
            "profile": profile,
            "orbit_constant": c,
            "drift": float(found.values["velocity_2"][i]) / scale,
            "uncertainty": float(found.errors["velocity_2"][i]) / scale,
            "theory": orbit_theory(k, c, profile),
            "along_vorticity": float(found.values["velocity_3"][i]) / scale,
        }
        for i, c in enumerate(constants)
    ]


def _local(k: float, distance: float, stokes: float) -> list[dict[str, Any]]:
    """Rate of ln C near tumbling, in the paraboloid and in shear of the rate where the body is.

    The torque in a quadratic flow is that of the gradient at the centre of the body: only the path
    can make a difference.
    """
    constant = 50.0 if k < 1.0 else 1e6
    relaxed = 10.0 * heavy.slowest_relaxation(k, stokes)
    axis = simulate.orbit_axes(k, constant)

    def rate(flow: PolynomialFlow, position: tuple[float, float, float]) -> simulate.Measured:
        return simulate.measure(k, flow, stokes, axis, HALF_TURNS, position, relaxed=relaxed)

    curved = rate(_flow(distance), (0.0, distance, 0.0))
    local = float(curved.values["position_2"][0]) / distance
    straight = rate(simulate.polynomial(type="shear", rate=local), (0.0, 0.0, 0.0))
    rates = [float(found.values["orbit_drift"][0]) for found in (curved, straight)]
    errors = [float(found.errors["orbit_drift"][0]) for found in (curved, straight)]
    return [
        {
            "table": "local_orbit_drift",
            "aspect_ratio": k,
            "stokes_number": stokes,
            "orbit": "tumbling",
            "distance": distance,
            "local_rate": local,
            "rate": rates[0],
            "uncertainty": errors[0],
            "shear_rate": rates[1],
            "difference": rates[0] / rates[1] - 1.0,
            "difference_uncertainty": sum(errors) / abs(rates[1]),
            "from_start": rates[0] / -heavy.tumbling_exponent(k, stokes) - 1.0,
        }
    ]


_K = Column("aspect_ratio", "", "equatorial over polar radius", "g", "k")
_ST = Column("stokes_number", "", "Stokes number", ".4g", "St")


def tables(rows: list[dict[str, Any]]) -> list[Table]:
    """The drift, its maximum and its theory, drift on orbits, and the drift of orbits."""
    unit = "K c^2"
    drift = Table(
        "lateral_drift",
        "Drift of tumbling bodies towards higher shear over the curvature K; local shear rate 1",
        (
            _K,
            _ST,
            Column("inertia", "", "of both motions, of translation or of rotation alone"),
            Column("distance", "c", "from the axis of the flow", "g"),
            Column("curvature", "1/(c tau)", "K = 1/(2 distance)", ".4g", "K"),
            Column("drift", unit, "mean velocity across the stream over K", ".5e"),
            Column("uncertainty", unit, "two tolerances, two windows", ".0e"),
            Column("local_rate", "1/tau", "mean shear rate on the way, 1 at the start", ".4f"),
            Column("theory", unit, "weak curvature, shear of the local rate", ".5e"),
            Column("small", unit, "limit of small St", ".3e"),
            Column("passed", "", "zero where it has to be"),
        ),
        notes=[
            "Positive: towards higher shear. Exactly zero for a sphere, and with inertia of the "
            "rotation alone."
        ],
        plot={
            "x": "stokes_number",
            "y": "drift",
            "by": "aspect_ratio",
            "scale": "loglog",
            "points": True,
        },
    )
    orbits = Table(
        "drift_on_orbits",
        "Drift over K St on Jeffery orbits for small St, inertia of the translation alone",
        (
            _K,
            Column("profile", "", "x2^2 + x3^2 (paraboloid) or x2^2 (plane)"),
            Column("orbit_constant", "", "C; inf is tumbling", "g", "C"),
            Column("drift", unit, "mean velocity across the stream over K St", ".5e"),
            Column("uncertainty", unit, "two tolerances, two windows", ".0e"),
            Column("theory", unit, "first order in St, averaged over the orbit", ".5e"),
            Column("along_vorticity", unit, "mean velocity along x3 over K St", ".1e"),
        ),
        plot={"x": "orbit_constant", "y": "drift", "by": ["aspect_ratio", "profile"]},
    )
    local = Table(
        "local_orbit_drift",
        "Drift of orbits in the paraboloid against shear of the local rate",
        (
            _K,
            _ST,
            Column("orbit", "", "near which it is measured"),
            Column("distance", "c", "from the axis of the flow", "g"),
            Column("local_rate", "1/tau", "mean shear rate on the way, 1 at the start", ".5f"),
            Column("rate", "1/tau", "d(ln C)/dt in the paraboloid", ".6e"),
            Column("uncertainty", "1/tau", "two tolerances, two windows", ".0e"),
            Column("shear_rate", "1/tau", "the same in shear of the local rate", ".6e", "in shear"),
            Column("difference", "", "relative", ".1e"),
            Column("difference_uncertainty", "", "of both rates", ".0e"),
            Column("from_start", "", "difference from shear of the starting rate", ".1e"),
        ),
        plot={"x": "distance", "y": "difference", "by": "aspect_ratio", "scale": "semilogx"},
    )
    curve = Table(
        "drift_curve",
        "Drift over K of tumbling bodies by the periodic solution, weak curvature, shear rate 1",
        (
            _K,
            _ST,
            Column("inertia", "", "of both motions, or of the translation alone"),
            Column("drift", unit, "of the periodic solution", ".5e"),
        ),
        plot={"x": "stokes_number", "y": "drift", "by": ["aspect_ratio", "inertia"],
              "scale": "loglog"},
    )  # fmt: skip
    maxima = [row for row in rows if row["table"] == "drift_maximum"]
    fill([drift, orbits, local, curve], [row for row in rows if row["table"] != "drift_maximum"])
    return [drift, _maxima(drift, maxima), orbits, local, curve]


def _maxima(drift: Table, theory: list[dict[str, Any]]) -> Table:
    """Where the drift is largest, and how it dies out, for every aspect ratio."""
    made = Table(
        "drift_maximum",
        "Largest drift over K, and its decay for light and heavy bodies",
        (
            _K,
            Column("stokes_number", "", "St of the maximum", ".4g", "St"),
            Column("lag", "", "St Theta/R (mean of R) there, times the shear rate", ".3f"),
            Column("drift", "K c^2", "the maximum, from the periodic solution", ".5e"),
            Column("measured_at", "", "St of the largest of the runs", ".4g"),
            Column("measured", "K c^2", "largest of the runs", ".5e"),
            Column("uncertainty", "K c^2", "of the largest of the runs", ".0e"),
            Column("light", "K c^2", "drift/St for St to 0", ".4e"),
            Column("heavy", "K c^2", "drift times St for St to infinity", ".4e"),
            Column("light_exponent", "", "of St, between the two lightest runs", ".3f"),
            Column("heavy_exponent", "", "of St, between the two heaviest runs", ".3f"),
            Column("rotation_share", "", "rotational inertia: drift over that without - 1", ".3f"),
        ),
        plot={"x": "aspect_ratio", "y": "drift", "scale": "loglog"},
    )
    for row in theory:
        chosen = (
            (drift["aspect_ratio"] == row["aspect_ratio"])
            & (drift["inertia"] == "both")
            & (drift["distance"] == FAR)
        )
        if not chosen.any():
            continue
        best = int(np.argmax(drift["drift"][chosen]))
        # A Stokes number may stand there twice: among these, and among those at every distance.
        order = np.unique(drift["stokes_number"][chosen], return_index=True)[1]
        logs = [np.log(drift[n][chosen][order]) for n in ("stokes_number", "drift")]
        exponents = np.diff(logs[1]) / np.diff(logs[0])
        made.add(
            **{name: value for name, value in row.items() if name != "table"},
            measured_at=float(drift["stokes_number"][chosen][best]),
            measured=float(drift["drift"][chosen][best]),
            uncertainty=float(drift["uncertainty"][chosen][best]),
            light_exponent=float(exponents[0]),
            heavy_exponent=float(exponents[-1]),
        )
    return made


def _maximum(k: float) -> list[dict[str, Any]]:
    """The largest drift over K of the periodic solution, and its limits."""
    from scipy.optimize import minimize_scalar

    scale = np.log(heavy.relaxation_rates(k)[0])
    found = minimize_scalar(
        lambda x: -heavy.drift(k, float(np.exp(x))),
        bounds=(scale - 5.0, scale + 4.0),
        method="bounded",
        options={"xatol": 1e-4},
    )
    stokes, top = float(np.exp(found.x)), float(-found.fun)
    across, along = heavy.relaxation_rates(k)[:2]
    return [
        {
            "table": "drift_maximum",
            "aspect_ratio": k,
            "stokes_number": stokes,
            "lag": stokes / (0.5 * (across + along)),
            "drift": top,
            "light": heavy.small_stokes_drift(k),
            "heavy": heavy.large_stokes_drift(k),
            "rotation_share": top / heavy.drift(k, stokes, "translation") - 1.0,
        }
    ]


def _curve(k: float, stokes_numbers: Array, parts: Inertia) -> list[dict[str, Any]]:
    """The drift of the periodic solution."""
    return [
        {
            "table": "drift_curve",
            "aspect_ratio": k,
            "stokes_number": stokes,
            "inertia": parts,
            "drift": heavy.drift(k, stokes, parts),
        }
        for stokes in stokes_numbers.tolist()
    ]


def _drift_figure(made: dict[str, Table]) -> Any:
    """Drift against St, its parts, distance, and the orbits."""
    from qbxstokes.plots import style

    drift, orbits, curve = (
        made[name] for name in ("lateral_drift", "drift_on_orbits", "drift_curve")
    )

    def theory(k: float, parts: Inertia) -> tuple[Array, Array]:
        shown = (curve["aspect_ratio"] == k) & (curve["inertia"] == parts)
        return curve["stokes_number"][shown], curve["drift"][shown]

    figure = style.new_figure(style.PAGE, 5.2)
    panels = figure.subplots(2, 2).ravel()
    far = drift["distance"] == FAR
    ratios = [k for k in sorted(set(drift["aspect_ratio"].tolist())) if k != 1.0]
    for index, k in enumerate(ratios):
        color, _, marker = style.LINES[index % 7]
        chosen = far & (drift["aspect_ratio"] == k) & (drift["inertia"] == "both")
        order = np.argsort(drift["stokes_number"][chosen])
        x, y = (drift[name][chosen][order] for name in ("stokes_number", "drift"))
        panels[0].plot(*theory(k, "both"), color=color)
        panels[0].plot(x, y, marker, color=color, label=f"{k:g}",
                       markerfacecolor="white" if k < 1.0 else color)  # fmt: skip
    panels[0].set_xscale("log")
    panels[0].set_yscale("log")
    panels[0].set_xlabel(r"Stokes number $\mathrm{St}$")
    panels[0].set_ylabel(r"drift$\,/\,K c^2$")
    for k in (k for k in _COMPARED if k in ratios):
        color, _, marker = style.LINES[ratios.index(k) % 7]
        dashes: dict[Inertia, Any] = {"both": "solid", "translation": (0, (4, 1.5))}
        light, last = heavy.small_stokes_drift(k), heavy.large_stokes_drift(k)
        scale = heavy.relaxation_rates(k)[0]
        for parts, look in dashes.items():
            chosen = far & (drift["aspect_ratio"] == k) & (drift["inertia"] == parts)
            # At the shear rate where the body was: St counts with that rate.
            x = drift["stokes_number"][chosen] * drift["local_rate"][chosen]
            fine, exact = theory(k, parts)
            panels[1].plot(fine / scale, exact * (1.0 / (light * fine) + fine / last),
                           color=color, linestyle=look)  # fmt: skip
            y = drift["drift"][chosen] * (1.0 / (light * x) + x / last)
            face = "white" if parts == "translation" else color
            panels[1].plot(x / scale, y, marker, color=color, markerfacecolor=face)
    for text, look in (("both", "solid"), ("translation alone", (0, (4, 1.5)))):
        panels[1].plot([], [], color=style.BLACK, linestyle=look, label=text)
    panels[1].axhline(1.0, color=style.GREY, linewidth=0.6, zorder=0)
    panels[1].set_xscale("log")
    panels[1].set_xlabel(r"$\mathrm{St}\,\Theta/R_1$")
    panels[1].set_ylabel(r"drift$\,/\,$limits of small and large $\mathrm{St}$, joined")
    panels[1].legend(loc="lower left", title="inertia")
    index = 0
    for k in (0.5, 2.0):
        rest = (drift["aspect_ratio"] == k) & (drift["inertia"] == "both")
        for stokes in (10.0, 100.0) if k < 1.0 else (1.0, 10.0):
            chosen = rest & (np.abs(drift["stokes_number"] / stokes - 1.0) < 1e-6)
            order = np.argsort(drift["distance"][chosen])
            places, values = (drift[n][chosen][order] for n in ("distance", "drift"))
            look = style.line_style(index, markers=True)
            panels[2].plot(places, values / heavy.drift(k, stokes), **look,
                           label=f"$k={k:g}$, $\\mathrm{{St}}={stokes:g}$")  # fmt: skip
            look |= {"markerfacecolor": look["color"], "linestyle": "none"}
            panels[2].plot(places, values / drift["theory"][chosen][order], **look)
            index += 1
    panels[2].axhline(1.0, color=style.GREY, linewidth=0.6, zorder=0)
    _doubling(panels[2])
    panels[2].set_ylabel(r"drift$\,/\,$weak curvature")
    panels[2].legend()
    index = 0
    for k in (0.5, 2.0):
        for profile in ("paraboloid", "plane"):
            chosen = (orbits["aspect_ratio"] == k) & (orbits["profile"] == profile)
            c = orbits["orbit_constant"][chosen]
            limit = orbits["theory"][chosen][np.isinf(c)][0]
            fine = np.geomspace(0.1, 1e4, 60)
            exact = np.array([orbit_theory(k, float(v), profile) for v in fine]) / limit
            color, dashed, marker = style.LINES[index]
            panels[3].plot(fine / (1.0 + fine), exact, color=color, linestyle=dashed)
            places = np.where(np.isinf(c), 1.0, c / (1.0 + np.where(np.isinf(c), 0.0, c)))
            panels[3].plot(places, orbits["drift"][chosen] / limit, linestyle="none",
                           color=color, marker=marker, markerfacecolor="white",
                           label=f"$k={k:g}$, {profile}")  # fmt: skip
            index += 1
    panels[3].set_xlabel("orbit $C/(1+C)$")
    panels[3].set_ylabel(r"drift$\,/\,$that of tumbling")
    panels[3].legend(loc="upper left")
    figure.legend(*panels[0].get_legend_handles_labels(), title="$k$", loc="outside right upper")
    style.letter_panels(list(panels))
    return figure


def _orbit_drift_figure(made: dict[str, Table]) -> Any:
    """How much the drift of orbits differs from that in shear, over the distance."""
    from qbxstokes.plots import style

    local = made["local_orbit_drift"]
    figure = style.new_figure(style.COLUMN, 2.4)
    axes = figure.add_subplot()
    for index, k in enumerate(sorted(set(local["aspect_ratio"].tolist()))):
        chosen = local["aspect_ratio"] == k
        look = style.line_style(index, markers=True)
        axes.plot(local["distance"][chosen], np.abs(local["from_start"][chosen]), **look,
                  label=f"$k={k:g}$, starting rate")  # fmt: skip
        look |= {"markerfacecolor": look["color"]}
        axes.plot(local["distance"][chosen], np.abs(local["difference"][chosen]), **look,
                  label=f"$k={k:g}$, local rate")  # fmt: skip
    axes.set_yscale("log")
    _doubling(axes)
    axes.set_ylabel("relative difference from shear")
    axes.legend()
    return figure


def _doubling(axes: Any) -> None:
    """Distances from the axis on a logarithmic scale, as plain numbers."""
    places = (1, 2, 4, 8, 16, 32)
    axes.set_xscale("log")
    axes.set_xticks(places, [str(place) for place in places])
    axes.minorticks_off()
    axes.set_xlabel("distance from the axis of the flow ($c$)")


FIGURES = {"lateral_drift": _drift_figure, "local_orbit_drift": _orbit_drift_figure}
