"""How many nodes the density needs, the quadrature being fixed.

A free body in shear with a paraboloid on top: the density on a spheroid is then a polynomial of
degree 3, which is fitted to a resolved solution. n_theta varies; the uniform scheme keeps 240 polar
source nodes (p = 18), the graded one panels of order 18 (p = 26).

Paper:    J. Bagge 2015, KTH, chapter 7.
Run:      python cases/studies/qbx_density_nodes.py      (25 s)
Expected: with four nodes graded force and motion are exact (1e-12) and the density errs by 1e-4,
          ten times less for every two nodes more; the uniform scheme ends at the error of its
          quadrature, 6e-4 (k = 1/2) and 1e-4 (k = 2) of the density.
"""

import math
import time

import common
import numpy as np
from common import Table, formed, power

import qbxstokes as qs
from qbxstokes.bie.operators import surface_operators
from qbxstokes.plots import style
from qbxstokes.qbx.operator import GradedScheme, UniformScheme

SOURCES = 240  # polar nodes of the upsampled grid
POWERS = [(a, b, c) for a in range(4) for b in range(4) for c in range(4) if a + b + c < 4]


def solution(k, scheme):
    """Monomials up to degree 3 at the nodes, and the density of the mobility problem there."""
    operators = surface_operators(qs.Spheroid(k), scheme, 9)
    points = operators.grid.points
    flow = common.every_term().velocity(points + np.array(common.PLACE))
    x, y, z = points.T
    monomials = np.stack([x**a * y**b * z**c for a, b, c in POWERS], axis=-1)
    return monomials, operators.mobility.inverse.apply(-flow)


def fixed_quadrature(k, name, nodes):
    """The scheme whose quadrature does not change with the nodes of the density."""
    if name == "graded":
        return GradedScheme(nodes, 26, 0.3, 18, 0.7)
    upsampling = SOURCES // nodes
    around = max(8, 2 * math.ceil(0.5 * max(k, 1.0) * SOURCES / upsampling))
    return UniformScheme(nodes, around, 18, 0.95 * common.largest_ratio(k, nodes), upsampling)


def measure(k, name, nodes, polynomial):
    """Errors of the density at its nodes and of the motion, and the time of a solution."""
    scheme = fixed_quadrature(k, name, nodes)
    begin = time.perf_counter()
    monomials, density = solution(k, scheme)
    spent = time.perf_counter() - begin
    exact = monomials @ polynomial
    error = np.abs(density - exact).max() / np.abs(exact).max()
    return {"density_error": error, "motion_error": formed(k, scheme)[1], "time": spent}


@common.command
def main(small=False):
    """Run, print, write and draw; errors at the fewest and at the most nodes."""
    ratios, numbers = ((0.5,), (4, 6)) if small else ((0.5, 2.0), (4, 6, 8, 10, 14, 20))
    curves = [(k, name) for k in ratios for name in ("uniform", "graded")]
    table = Table("qbx_density_nodes", "relative errors of density and motion; time in s")
    for k in ratios:
        monomials, density = solution(k, GradedScheme(28, 32, 0.3, 22, 0.6))
        polynomial, *_ = np.linalg.lstsq(monomials, density, rcond=1e-12)
        for name in ("uniform", "graded"):
            for nodes in numbers:
                row = measure(k, name, nodes, polynomial)
                table.add(aspect_ratio=k, scheme=name, n_theta=nodes, **row)
    table.write()
    print("Error of the density / of force and motion / set-up and solve (s)")
    common.markdown(
        ("n_θ", *(f"k = {k:g}, {name}" for k, name in curves)),
        [(f"{n}", *(f"{power(row['density_error'])} / {power(row['motion_error'])} / "
                    f"{row['time']:.2f}" for row in table.where(n_theta=n).rows))
         for n in numbers],
    )  # fmt: skip
    with common.figure("qbx_density_nodes", style.COLUMN, 2.9) as (panel,):
        common.labelled(panel, r"$n_\vartheta$", "error of the density", "y")
        for index, (k, name) in enumerate(curves):
            part, look = table.where(aspect_ratio=k, scheme=name), style.line_style(index, True)
            panel.plot(part["n_theta"], part["density_error"], label=f"$k={k:g}$, {name}", **look)
        panel.set_xticks((5, 10, 15, 20))
        panel.legend(fontsize=7)
    graded, uniform = (table.where(aspect_ratio=0.5, scheme=name) for name in ("graded", "uniform"))
    return {
        "graded, fewest nodes, motion": graded["motion_error"][0],
        "graded, fewest nodes, density": graded["density_error"][0],
        "graded, most nodes, density": graded["density_error"][-1],
        "uniform, most nodes, density": uniform["density_error"][-1],
    }
