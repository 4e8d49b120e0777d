"""The stresslet of bodies where they are in a flow, and what it needs of the hydrodynamics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.bie.accuracy import choose_scheme
from qbxstokes.bie.stresslet import N_PHI, GridStress, Stresslet, accurate_stresslet
from qbxstokes.flows import Flow
from qbxstokes.flows.changing import ChangingFlow
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.geometry.symmetric import components
from qbxstokes.motion.layout import POSITION
from qbxstokes.motion.stress import mean_strain, stresslets, torque_stresslets
from qbxstokes.reference.stress import stresslet_numbers
from qbxstokes.simulation.hydrodynamics import (
    explicit_scheme,
    side_of,
    solver_factory,
    solver_tolerance,
)
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.assembly import Assembled
    from qbxstokes.simulation.formed_body import FormedBody


# Share of the tolerance that the grid of a flow that is not polynomial may take.
_FLOW_SHARE = 0.1


def form_stresslet(body: FormedBody) -> Stresslet:
    """The stresslet of a body to its tolerance, from the cache if it is there; raises as `Body`."""
    workshop, section, shape = body.workshop, body.settings, body.shape
    fixed = explicit_scheme(section)
    scheme = fixed or choose_scheme(section.tolerance, side=side_of(section))
    key = {
        "shape": shape.spec(),
        "tolerance": section.tolerance,
        "scheme": [section.scheme, asdict(scheme)],
        "residual": solver_tolerance(section, shape),
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
        solver=solver_factory(section, []),
        form_rows=workshop.form_rows,
    )
    if found.functional.grid.n_theta == scheme.n_theta:
        workshop.cache.store("stresslet", key, found.to_arrays())
    return found


def _fault(grid: SurfaceGrid, arrays: Mapping[str, Any]) -> str:
    """What is wrong with a stresslet that was kept: its functional and the closed forms agree."""
    kept = Stresslet.from_arrays(grid, arrays)
    known = kept.numbers
    if isinstance(grid.shape, Spheroid):
        known = np.array(stresslet_numbers(grid.shape.aspect_ratio))
    found = np.stack([kept.functional.numbers(), kept.numbers])
    missed = float(np.abs(found / known - 1.0).max())
    good = missed <= max(30.0 * kept.error_estimate, 1e-8)
    return "" if good else "does not hold the stresslet of this body"


class FreeStress:
    """Stresslets, free of torque, of copies of one body anywhere in one flow.

    By the table of a polynomial flow of degree <= 3, otherwise by the functional on a grid.
    """

    def __init__(self, body: FormedBody, flow: Flow, stresslet: Stresslet) -> None:
        self.stresslet, self._flow, axes = stresslet, flow, body.shape.semi_axes
        self._grid: GridStress | None = None
        # Third derivatives enter by the volume average of an ellipsoid.
        if flow.degree is not None and flow.degree <= (2 if axes is None else 3):
            self._k = 1.0 if axes is None else axes[0]
        else:
            self._grid = GridStress(stresslet, flow, _FLOW_SHARE * body.tolerance)

    def gradient(self, t: float, x: Array) -> Array:
        """Velocity gradient (n, 3, 3) of the flow at positions x (n, 3)."""
        return np.asarray(self._flow.gradient(x, t))

    def __call__(self, t: float, x: Array, q: Array, axis: Array) -> Array:
        """S (n, 6) in space at positions x (n, 3), quaternions q (n, 4), axes (n, 3)."""
        if self._grid is not None:
            return components(self._grid.stresslet(t, x, q))
        flow = self._flow.at(t) if isinstance(self._flow, ChangingFlow) else self._flow.polynomial
        assert flow is not None
        strain = mean_strain(flow, x, axis, self._k)
        return np.ascontiguousarray(stresslets(self.stresslet.numbers, axis, strain).T)


class SceneStress:
    """Stresslets of the lanes of assembled scenes, with what their torques add.

    The stresslets of their bodies are formed where need be.
    """

    def __init__(self, assembled: Assembled) -> None:
        parts, lanes = assembled.parts, assembled.slices()
        frees = [FreeStress(part.body, part.flow, part.body.stress) for part in parts]
        self._parts = list(zip(frees, lanes, strict=True))
        models = [formed.model for formed in assembled.hydrodynamics]
        counts = [len(part) for part in parts]
        self._linear = np.repeat([model.faxen.linear for model in models], counts)
        self.thermal: Array | None = None
        if parts[0].brownian is not None:
            strengths = [
                3.0 * part.brownian.rotary_diffusivity * model.resistance.rotation_transverse
                for part, model in zip(parts, models, strict=True)
                if part.brownian is not None
            ]
            self.thermal = np.repeat(strengths, counts) * self._linear

    def _each(self, count: int, width: tuple[int, ...], values: Callable[..., Array]) -> Array:
        """Values (count, *width) of each scene's states; instants of the same lanes follow."""
        if len(self._parts) == 1:
            return values(self._parts[0][0], slice(None))
        numbers, found = np.arange(count).reshape(-1, len(self._linear)), np.empty((count, *width))
        for free, lanes in self._parts:
            chosen = numbers[:, lanes].ravel()
            found[chosen] = values(free, chosen)
        return found

    def gradient(self, t: float, states: Array) -> Array:
        """Velocity gradient (n, 3, 3) of the background flow at the centres."""
        return self._each(
            len(states), (3, 3), lambda free, own: free.gradient(t, states[own, POSITION])
        )

    def stresslet(self, t: float, x: Array, q: Array, p: Array, torque: Array | None) -> Array:
        """S (n, 6) in space, positions x (n, 3), unit quaternions q (n, 4) and axes p (n, 3).

        torque: hydrodynamic, (n, 3), None where there is none.
        """
        found = self._each(len(x), (6,), lambda free, own: free(t, x[own], q[own], p[own]))
        if torque is not None:
            linear = np.tile(self._linear, len(x) // len(self._linear))
            found = found + torque_stresslets(linear, p, torque)
        return found
