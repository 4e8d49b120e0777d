"""How order, radius and upsampling of uniform quadrature share the error.

A spheroid of k = 1/2 with n_theta = 14. The truncation error is that of the same expansions
integrated all but exactly, the quadrature error the change from there.

Paper:    J. Bagge 2015, KTH, chapter 7; A. Kloeckner et al. 2013, J. Comput. Phys. 252, 332.
Run:      python cases/studies/qbx_truncation.py      (35 s)
Expected: least errors of 4.4e-2, 6.6e-3 and 1.3e-5 for kappa = 4, 8 and 16, at p = 4, 9 and 24 and
          the largest radius each.
"""

from dataclasses import dataclass

import common
import numpy as np
from common import Table, formed, power

import qbxstokes as qs
from qbxstokes.bie.accuracy import model_distance
from qbxstokes.plots import style
from qbxstokes.qbx.operator import GradedScheme, UniformScheme

BODY, N_THETA = qs.Spheroid(0.5), 14


@dataclass(frozen=True)
class Resolved(GradedScheme):
    """The expansions of a uniform scheme with quadrature that is all but exact."""

    of: UniformScheme | None = None

    def radius(self, spheroid, theta):
        """The global radius."""
        return self.of.radius(spheroid, theta)

    def grid(self, spheroid, n_phi):
        """The grid of the uniform scheme."""
        return self.of.grid(spheroid, n_phi)


def measure(r_over_h, order, upsamplings, table):
    """Add error, its truncation and its quadrature part; nan where the radius is forbidden."""
    allowed = r_over_h <= common.largest_ratio(BODY.aspect_ratio, N_THETA)
    for kappa in upsamplings:
        row = dict.fromkeys(("error", "truncation", "quadrature", "time"), np.nan)
        if allowed:
            scheme = common.uniform(BODY.aspect_ratio, N_THETA, order, r_over_h, kappa)
            if kappa == upsamplings[0]:
                exact = Resolved(N_THETA, order, 1.0, 16, 0.7, "average", False, scheme)
                resolved, truncation, _ = formed(BODY.aspect_ratio, exact)
            model, error, spent = formed(BODY.aspect_ratio, scheme)
            row = {"error": error, "truncation": truncation, "time": spent}
            row["quadrature"] = model_distance(model, resolved)
        table.add(upsampling=kappa, r_over_h=r_over_h, expansion_order=order, **row)


def draw(table, upsamplings, ratios):
    """The valley between truncation and quadrature; error over radius and order, as a map."""
    shown = [*ratios[:1], *ratios[max(1, len(ratios) - 3) :]]
    with common.figure("qbx_valley", style.PAGE, 2.7, 1, len(upsamplings), "$r/h$",
                       sharey=True) as panels:  # fmt: skip
        for panel, kappa in zip(panels, upsamplings, strict=True):
            for (color, *_), ratio in zip(style.LINES, shown, strict=False):
                part = table.where(upsampling=kappa, r_over_h=ratio)
                p, look = part["expansion_order"], {"color": color}
                panel.plot(p, part["error"], "o", markersize=3, label=f"{ratio:.2f}", **look)
                panel.plot(p, part["truncation"], **look)
                panel.plot(p, part["quadrature"], linestyle=(0, (3, 1.5)), **look)
            common.labelled(panel, "expansion order $p$", "", "y")
            panel.set_ylim(1e-13, 10.0)
            panel.set_title(rf"$\kappa = {kappa}$", loc="left")
        panels[0].set_ylabel("relative error")
        for text, look in (("truncation", "-"), ("quadrature", (0, (3, 1.5)))):
            panels[0].plot([], [], color=style.BLACK, linestyle=look, label=text)
        panels[0].plot([], [], "o", color=style.BLACK, markersize=3, label="total")
    forbidden = {"facecolor": "#f2f2f2", "edgecolor": style.GREY, "hatch": "////", "linewidth": 0}
    with common.figure("qbx_map", style.PAGE, 2.5, 1, len(upsamplings), sharey=True) as panels:
        ratios, orders = (np.unique(table[name]) for name in ("r_over_h", "expansion_order"))
        for panel, kappa in zip(panels, upsamplings, strict=True):
            part = table.where(upsampling=kappa)
            errors = part["error"].reshape(len(ratios), len(orders)).T
            look = {"norm": "log", "vmin": 1e-5, "vmax": 10.0, "shading": "nearest"}
            mesh = panel.pcolormesh(ratios, orders, errors, **look)
            decades = 10.0 ** np.arange(-4.0, 1.0)
            panel.contour(ratios, orders, errors, decades, colors="white", linewidths=0.7)
            best = part.rows[np.nanargmin(part["error"])]
            star = {"color": "white", "markersize": 9, "markeredgecolor": style.BLACK}
            panel.plot(best["r_over_h"], best["expansion_order"], "*", **star)
            panel.axvspan(0.5 * (ratios[-2] + ratios[-1]), panel.get_xlim()[1], **forbidden)
            panel.set_xlabel("$r/h$")
            panel.set_title(rf"$\kappa = {kappa}$", loc="left")
        panels[0].set_ylabel("expansion order $p$")
        panels[0].figure.colorbar(mesh, ax=panels, label="relative error", pad=0.01)


@common.command
def main(small=False):
    """Run, print, write and draw; the least error of each upsampling and its order."""
    upsamplings = (4, 8) if small else (4, 8, 16)
    parts = (1.0, 1.2) if small else (0.15, 0.3, 0.5, 0.7, 1.0, 1.2)  # the last is forbidden
    orders = (4, 9) if small else (2, 4, 6, 9, 13, 18, 24)
    largest = common.largest_ratio(BODY.aspect_ratio, N_THETA)
    ratios = [round(part * largest, 4) for part in parts]
    table = Table("qbx_truncation", "relative errors; nan where the ball crosses the surface; s")
    for r_over_h in ratios:
        for order in orders:
            measure(r_over_h, order, upsamplings, table)
    table.write()
    best = []
    for kappa in upsamplings:
        for r_over_h in ratios[:-1]:
            part = table.where(upsampling=kappa, r_over_h=r_over_h)
            best.append(part.rows[np.argmin(part["error"])])
    common.markdown(
        ("κ", "r/h", "best p", "error", "truncation", "quadrature", "time (s)"),
        [(f"{row['upsampling']}", f"{row['r_over_h']:.2f}", f"{row['expansion_order']}",
          *(power(row[name]) for name in ("error", "truncation", "quadrature")),
          f"{row['time']:.2f}") for row in best],
    )  # fmt: skip
    draw(table, upsamplings, ratios[:-1])
    found = {}
    for kappa in upsamplings:
        row = min((r for r in best if r["upsampling"] == kappa), key=lambda r: r["error"])
        found[f"kappa {kappa}, least error"] = row["error"]
        found[f"kappa {kappa}, its p"] = row["expansion_order"]
        found[f"kappa {kappa}, its part of the largest r/h"] = row["r_over_h"] / largest
    return found
