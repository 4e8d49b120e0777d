"""Dilute suspensions by single axes with Brownian motion, followed one by one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import SceneError
from qbxstokes.flows import Flow
from qbxstokes.simulation.body import Body
from qbxstokes.simulation.result import shown
from qbxstokes.simulation.rheology import Dilute, starts_of
from qbxstokes.suspension.langevin import Ensemble, Sums, longest_step
from qbxstokes.suspension.particle import History, Protocol
from qbxstokes.typing import Array

Pair = tuple[Array, Array]

# A step where nobody says: by the flow, and as a share of the longest one by diffusion.
_STEP, _SHARE = 0.05, 0.05
_MOST_STEPS = 10_000_000


@dataclass(frozen=True, repr=False)
class BrownianAverages:
    """Means over trajectories, and over time in a steady state, as (mean, standard error).

    Units and meanings as in `Rheology`, with the axes (peclet_number, time), those that were asked
    for; tensors are (..., 3, 3). mean_square_displacement: <dx dx> since the start by the flow and
    by diffusion, in c^2, None where it was not asked for. paths: axes (..., m, 3) of the
    trajectories that were kept. step: the longest, (...) by Peclet number.
    """

    peclet_number: Array
    time: Array | None
    intrinsic_viscosity: Pair
    first_normal_stress_difference: Pair
    second_normal_stress_difference: Pair
    particle_stress: Pair
    hydrodynamic_stress: Pair
    brownian_stress: Pair
    order_tensor: Pair
    mean_square_displacement: Pair | None
    paths: Array | None
    trajectories: int
    step: Array
    summary: dict[str, Any]

    def __repr__(self) -> str:
        times = {} if self.time is None else {"time": self.time}
        heading = f"BrownianAverages: means over {self.trajectories} axes"
        return shown(heading, self.arrays() | times, self.summary)

    def arrays(self) -> dict[str, Array]:
        """Means by name, and their errors as NAME_standard_error."""
        found = {"peclet_number": self.peclet_number}
        for name, value in vars(self).items():
            if isinstance(value, tuple):
                found[name], found[f"{name}_standard_error"] = value
        return found if self.paths is None else found | {"paths": self.paths}


def langevin(
    body: Body,
    flow: Flow,
    peclet_number: ArrayLike = 10.0,
    *,
    protocol: Protocol = "steady",
    times: ArrayLike | None = None,
    amplitude: float | None = None,
    frequency: float | None = None,
    orientations: ArrayLike | str = "isotropic",
    trajectories: int = 4096,
    strain: float = 50.0,
    step: float | None = None,
    seed: int = 0,
    paths: int = 0,
    translation: bool = False,
    position: ArrayLike = (0.0, 0.0, 0.0),
    averaging: Callable[[Ensemble], list[Sums]] | None = None,
) -> BrownianAverages:
    """What `rheology` computes, from Brownian trajectories: a second, independent way.

    peclet_number, protocol, times, amplitude, frequency: as there; the numbers are finite.
    orientations: of a start-up, "isotropic" or axes (m, 3), with which the trajectories begin in
    turn, such as the sample of a distribution. trajectories: how many. strain: over which a steady
    state is averaged, after three relaxation times 1/(6 D) or a fifth of it. step: the longest, in
    units of 1/rate; the bias is of its second order. paths: how many trajectories to keep.
    translation: diffuse as well, with the mobility of the body, and tell the mean square
    displacement of a start-up. The random numbers of a trajectory depend on seed, its number and
    the step alone. averaging: who averages the blocks of trajectories.

    >>> import qbxstokes as qs
    >>> body, shear = qs.Body(0.2), qs.flow("shear")
    >>> mean, error = qs.langevin(body, shear, 10.0, trajectories=256).intrinsic_viscosity
    >>> exact = qs.rheology(body, shear, 10.0).intrinsic_viscosity
    >>> bool(abs(mean - exact) < 4.0 * error)
    True
    """
    random = {"trajectories": trajectories, "strain": strain, "step": step, "seed": seed}
    random |= {"paths": paths, "translation": translation}
    dilute = Dilute(
        body,
        flow,
        peclet_number,
        position,
        protocol=protocol,
        times=times,
        amplitude=amplitude,
        frequency=frequency,
        langevin={key: value for key, value in random.items() if value is not None},
    )
    numbers, history = dilute.numbers, dilute.history
    if np.any(body.stokes_number):
        wrong = f"is {np.max(body.stokes_number):g}"
        raise SceneError("stokes_number", wrong, "0: Brownian motion is that of massless bodies")
    starts = starts_of(orientations, None, np.full(1, np.inf)).axes
    if starts is not None and protocol != "startup":
        raise SceneError("orientations", f"have no meaning for {protocol}", "protocol: startup")
    particle, _ = dilute.formed
    found, steps = [], []
    for peclet in np.atleast_1d(numbers).tolist():
        ensemble = Ensemble(
            dilute.transport,
            particle,
            1.0 / peclet,
            history,
            trajectories,
            seed,
            _step(step, 1.0 / peclet, history),
            max(0.5 * peclet, 0.2 * strain),
            strain,
            starts,
            paths,
            _dispersion(body, particle.resistance / peclet) if translation else None,
        )
        _check(ensemble)
        blocks = map(ensemble.average, range(ensemble.blocks))
        found.append(Sums.of(list(blocks) if averaging is None else averaging(ensemble)))
        steps.append(ensemble.step)

    def shaped(values: list[Array]) -> Array:
        rows = np.stack(values) if history.instants is not None else np.stack(values)[:, 0]
        return np.asarray(rows if numbers.ndim else rows[0])[()]

    every = [sums.averages() for sums in found]
    named: dict[str, Any] = {
        name: (shaped([one[name][0] for one in every]), shaped([one[name][1] for one in every]))
        for name in every[0]
    }
    return BrownianAverages(
        peclet_number=numbers,
        time=history.instants,
        **{"mean_square_displacement": None, **named},
        paths=shaped([sums.paths for sums in found]) if paths else None,
        trajectories=trajectories,
        step=np.reshape(steps, numbers.shape)[()],
        summary={
            **dilute.summary,
            "method": "langevin",
            "trajectories": trajectories,
            "step": steps,
            "seed": seed,
        },
    )


def _step(given: float | None, diffusivity: float, history: History) -> float:
    longest = longest_step(diffusivity)
    if history.cycle is not None:  # a fraction of a cycle resolves the rate
        longest = min(longest, 0.25 / history.cycle)
    chosen = min(_STEP, _SHARE * longest) if given is None else given
    if not 0.0 < chosen <= longest:
        raise SceneError("step", f"is {chosen:g}", f"more than 0, at most {longest:g}")
    return chosen


def _check(ensemble: Ensemble) -> None:
    """Refuse what has no step, or more than anyone waits for."""
    if not ensemble.strain >= ensemble.step:
        wrong, right = f"is {ensemble.strain:g}", f"more than the step, {ensemble.step:g}"
        raise SceneError("strain", wrong, right)
    instants = ensemble.history.instants
    end = ensemble.strain if instants is None else float(instants[-1])
    steps = (end + ensemble.history.lead(ensemble.wait)) / ensemble.step
    if steps > _MOST_STEPS:
        wrong = f"{1.0 / ensemble.diffusivity:g} takes {steps:.1e} steps of {ensemble.step:g}"
        raise SceneError("peclet_number", wrong, f"at most {_MOST_STEPS:.0e} steps, or rheology")


def _dispersion(body: Body, energy: float) -> tuple[float, float]:
    """Diffusivities across and along the axis, kT over the resistances, in c^2 times the rate."""
    resistance = body.model.resistance
    return energy / resistance.translation_transverse, energy / resistance.translation_axial
