"""The stresslet of bodies where they are in a flow, and what it needs of the hydrodynamics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
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
    Workshop,
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


def form_stresslet(body: FormedBody, workshop: Workshop | None = None) -> Stresslet:
    """The stresslet of a body to its tolerance, from the cache if it is there; raises as `Body`."""
    workshop, section, shape = workshop or Workshop(), body.settings, body.shape
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
    try:
        kept = Stresslet.from_arrays(grid, arrays)
        acting = kept.functional.numbers()
        known = kept.numbers
        if isinstance(grid.shape, Spheroid):
            known = np.array(stresslet_numbers(grid.shape.aspect_ratio))
        missed = float(np.abs(np.stack([acting, kept.numbers]) / known - 1.0).max())
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        return f"does not hold a stresslet ({' '.join(str(error).split())})"
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
        return stresslets(self.stresslet.numbers, axis, strain).T


class SceneStress:
    """Stresslets of the lanes of assembled scenes, with what their torques add."""

    def __init__(self, parts: Sequence[tuple[FreeStress, slice]], linear: Array) -> None:
        """parts: of each scene with its lanes. linear: lambda of each lane (n,)."""
        self._parts, self._linear = parts, linear
        self.thermal: Array | None = None

    @classmethod
    def of(cls, assembled: Assembled) -> SceneStress:
        """That of assembled scenes; forms the stresslets of their bodies where need be."""
        slices, linear = assembled.slices(), np.empty(len(assembled.initial))
        parts = []
        for part, formed, lanes in zip(
            assembled.parts, assembled.hydrodynamics, slices, strict=True
        ):
            parts.append((FreeStress(part.body, part.flow, part.body.stress), lanes))
            linear[lanes] = formed.model.faxen.linear
        found = cls(parts, linear)
        if assembled.parts[0].brownian is not None:
            found.thermal = np.concatenate(
                [
                    np.full(len(part), 3.0 * part.brownian.rotary_diffusivity)
                    * formed.model.resistance.rotation_transverse
                    * formed.model.faxen.linear
                    for part, formed in zip(assembled.parts, assembled.hydrodynamics, strict=True)
                    if part.brownian is not None
                ]
            )
        return found

    def gradient(self, t: float, states: Array) -> Array:
        """Velocity gradient (n, 3, 3) of the background flow at the centres."""
        found = np.empty((len(states), 3, 3))
        for free, chosen in self._chosen(len(states)):
            if len(self._parts) == 1:
                return free.gradient(t, states[:, POSITION])
            found[chosen] = free.gradient(t, states[chosen, POSITION])
        return found

    def _chosen(self, count: int) -> Iterator[tuple[FreeStress, Any]]:
        """The states of each scene; several instants of the same lanes follow each other."""
        if len(self._parts) == 1:
            yield self._parts[0][0], slice(None)
            return
        numbers = np.arange(count).reshape(-1, len(self._linear))
        for free, lanes in self._parts:
            yield free, numbers[:, lanes].ravel()

    def stresslet(self, t: float, x: Array, q: Array, p: Array, torque: Array | None) -> Array:
        """S (n, 6) in space, positions x (n, 3), unit quaternions q (n, 4) and axes p (n, 3).

        torque: hydrodynamic, (n, 3), None where there is none.
        """
        found = np.empty((len(x), 6))
        for free, chosen in self._chosen(len(x)):
            found[chosen] = free(t, x[chosen], q[chosen], p[chosen])
        if torque is not None:
            linear = np.tile(self._linear, len(x) // len(self._linear))
            found += torque_stresslets(linear, p, torque)
        return found
