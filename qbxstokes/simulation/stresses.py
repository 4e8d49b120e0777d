"""The stresslet of bodies where they are in a flow, and what it needs of the hydrodynamics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.bie.accuracy import choose_scheme
from qbxstokes.bie.stresslet import N_PHI, GridStress, Stresslet, accurate_stresslet
from qbxstokes.flows import Flow
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import SurfaceGrid
from qbxstokes.motion.equations import Loads, RigidBodyEquations
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.motion.stress import mean_strain, stresslets, torque_stresslets
from qbxstokes.reference.stress import stresslet_numbers
from qbxstokes.simulation.hydrodynamics import (
    Workshop,
    explicit_scheme,
    side_of,
    solver_factory,
    solver_tolerance,
)
from qbxstokes.simulation.simulation import ORIGIN, Simulation

if TYPE_CHECKING:
    from qbxstokes.simulation.body import Body

Array = NDArray[np.float64]

# Share of the tolerance that the grid of a flow that is not polynomial may take.
_FLOW_SHARE = 0.1


def form_stresslet(
    body: Body, workshop: Workshop | None = None, solvers: list[Any] | None = None
) -> Stresslet:
    """The stresslet of a body to its tolerance, from the cache if it is there; raises as `Body`.

    solvers: takes the GMRES solvers that were used.
    """
    workshop, section, shape = workshop or Workshop(), body.settings, body.shape
    fixed = explicit_scheme(section)
    scheme = fixed or choose_scheme(section.tolerance, side=side_of(section))
    key = {
        "aspect_ratio": shape.aspect_ratio,
        "tolerance": section.tolerance,
        "scheme": [section.scheme, asdict(scheme)],
        "residual": solver_tolerance(section),
        "preconditioner": section.preconditioner,
    }
    grid = scheme.grid(shape, N_PHI)
    arrays = workshop.cache.load("stresslet", key, partial(_fault, grid))
    if arrays is not None:
        return Stresslet.from_arrays(grid, arrays)
    found = accurate_stresslet(
        shape,
        section.tolerance,
        scheme,
        fixed=fixed is not None,
        strict=body.strict,
        solver=solver_factory(section, [] if solvers is None else solvers),
        form_rows=workshop.form_rows,
    )
    if found.functional.grid.n_theta == scheme.n_theta:
        workshop.cache.store("stresslet", key, found.to_arrays())
    return found


def _fault(grid: SurfaceGrid, arrays: Mapping[str, Any]) -> str:
    """What is wrong with a stresslet that was kept: its functional and the closed forms agree."""
    try:
        kept = Stresslet.from_arrays(grid, arrays)
        acting = kept.functional.numbers()
        known = np.array(stresslet_numbers(grid.spheroid.aspect_ratio))
        missed = float(np.abs(np.stack([acting, kept.numbers]) / known - 1.0).max())
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        return f"does not hold a stresslet ({' '.join(str(error).split())})"
    good = missed <= max(30.0 * kept.error_estimate, 1e-8)
    return "" if good else "does not hold the stresslet of this body"


class FreeStress:
    """Stresslets, free of torque, of copies of one body anywhere in one flow.

    By the table of a polynomial flow of degree <= 3, otherwise by the functional on a grid.
    """

    def __init__(self, body: Body, flow: Flow, stresslet: Stresslet) -> None:
        self.stresslet, self._k = stresslet, body.aspect_ratio
        self._polynomial: PolynomialFlow | None = None
        if flow.degree is not None and flow.degree <= 3:
            self._polynomial = flow.polynomial
        else:
            self._grid = GridStress(stresslet, flow, _FLOW_SHARE * body.tolerance)

    def __call__(self, t: float, x: Array, q: Array) -> Array:
        """S (n, 3, 3) in space at positions x (n, 3), orientations q (n, 4)."""
        if self._polynomial is None:
            return self._grid.stresslet(t, x, q)
        axis = rotation.axis(q)
        strain = mean_strain(self._polynomial, x, axis, self._k)
        return stresslets(self.stresslet.numbers, axis, strain)


class SceneStress:
    """Stresslets of the lanes of assembled scenes, with what their torques add."""

    def __init__(
        self,
        equations: RigidBodyEquations,
        parts: Sequence[tuple[FreeStress, slice]],
        linear: Array,
    ) -> None:
        """parts: of each scene with its lanes. linear: lambda of each lane (n,)."""
        self.equations, self._parts, self._linear = equations, parts, linear

    def stresslet(self, t: float, states: Array, torque: Array | None) -> Array:
        """S (n, 3, 3) in space in the states (n, n_state); torque: hydrodynamic, (n, 3)."""
        n_lanes, x, q = len(self._linear), states[:, POSITION], states[:, ORIENTATION]
        q = rotation.normalize(q)
        found = np.empty((len(states), 3, 3))
        for free, lanes in self._parts:
            # Several instants of the same lanes follow each other.
            chosen = np.arange(len(states)).reshape(-1, n_lanes)[:, lanes].ravel()
            found[chosen] = free(t, x[chosen], q[chosen])
        if torque is not None:
            linear = np.tile(self._linear, len(states) // n_lanes)
            found += torque_stresslets(linear, rotation.axis(q), torque)
        return found


def body_stresslet(
    body: Body,
    flow: Flow,
    position: ArrayLike,
    orientation: ArrayLike,
    motion: tuple[ArrayLike | None, ArrayLike | None],
    loads: tuple[ArrayLike | None, ArrayLike | None],
    t: float,
) -> Array:
    """`Body.stresslet`: motion is (velocity, angular velocity), loads (force, torque)."""
    # With inertia the velocities are part of the state, whatever the Stokes number.
    held = any(u is not None for u in motion)
    velocity, spin = (ORIGIN if held and u is None else u for u in motion)
    pushed = any(f is not None for f in loads)
    scene = Simulation(
        body.with_inertia(1.0 if held else 0.0),
        flow,
        position=position,
        orientation=orientation,
        velocity=velocity,
        angular_velocity=spin,
        loads=Loads(*(ORIGIN if f is None else f for f in loads)) if pushed else None,
    )
    assembled = scene.assemble(t=t)
    stress = SceneStress(
        assembled.equations,
        [(FreeStress(body, flow, body.stress), slice(None))],
        np.full(len(scene), assembled.hydrodynamics[0].model.faxen.linear),
    )
    torque = assembled.equations.force_torque(t, assembled.initial)[1] if held or pushed else None
    return scene.shaped(stress.stresslet(t, assembled.initial, torque))
