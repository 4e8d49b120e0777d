"""The rheology of dilute suspensions of one body: material functions of its orientations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.case.rheology import RheologySection
from qbxstokes.case.values import Problem
from qbxstokes.errors import SceneError
from qbxstokes.flows import Flow
from qbxstokes.motion.averages import ShearFrame
from qbxstokes.simulation.arguments import numbers as as_numbers
from qbxstokes.simulation.arguments import require_flow
from qbxstokes.simulation.body import Body
from qbxstokes.simulation.inertial import inertial_means
from qbxstokes.simulation.result import shown
from qbxstokes.suspension import orbits
from qbxstokes.suspension.distribution import Distribution
from qbxstokes.suspension.fokker_planck import Evolution, Transport, converged, isotropic
from qbxstokes.suspension.orbits import Starts
from qbxstokes.suspension.particle import History, LinearFlow, Particle, Protocol
from qbxstokes.typing import Array

# Instants of a transient or a cycle, and the strain that a transient covers, where nobody says.
SAMPLES, _STRAIN = 201, 20.0


@dataclass(frozen=True, repr=False)
class Rheology:
    """Stress of a dilute suspension, per volume fraction and mu times the flow's rate.

    Arrays have the axes (peclet_number, time, ...), those that were asked for. The rate is that of
    the flow, sqrt(2 E:E), in an oscillation its amplitude. particle_stress (..., 3, 3) is
    hydrodynamic_stress + brownian_stress + inertial_stress; intrinsic_viscosity =
    Sigma:E/(2 E:E), Sigma_12 of a shear; N1 = Sigma_11 - Sigma_22 and N2 = Sigma_22 - Sigma_33 over
    rate, NaN in other flows; order_tensor <pp> (..., 3, 3). time: in units of 1/rate, None of a
    steady state. distribution: one or a list of them; the last one of a transient; None without
    Brownian motion where the orientations are not isotropic at first, or come to a single one.
    error_estimate: relative, of the stress.
    """

    peclet_number: Array
    time: Array | None
    intrinsic_viscosity: Array
    first_normal_stress_difference: Array
    second_normal_stress_difference: Array
    particle_stress: Array
    hydrodynamic_stress: Array
    brownian_stress: Array
    inertial_stress: Array
    order_tensor: Array
    error_estimate: Array
    distribution: Any
    summary: dict[str, Any]

    def __repr__(self) -> str:
        times = {} if self.time is None else {"time": self.time}
        return shown("Rheology: a dilute suspension", self.arrays() | times, self.summary)

    def arrays(self) -> dict[str, Array]:
        """The quantities of `quantities.RHEOLOGY` by name."""
        skipped = ("time", "distribution", "summary")
        return {name: value for name, value in vars(self).items() if name not in skipped}


def particle_of(body: Body) -> tuple[Particle, float]:
    """What the rheology needs of a body, and the relative error that it has."""
    formed, _ = body.formed(1, "surface")
    model = formed.model
    stress = body.stress
    particle = Particle(
        stress.numbers, model.faxen.linear, model.resistance.rotation_transverse, body.shape.volume
    )
    return particle, model.error_estimate + stress.error_estimate


def linear_flow(flow: Flow, position: ArrayLike) -> LinearFlow:
    """The homogeneous flow that a flow is; SceneError where it is none or strains nothing."""
    require_flow(flow)
    if flow.degree is None or flow.degree > 1:
        raise SceneError("flow", "is not homogeneous", "a flow of degree 1, such as shear")
    if not flow.steady:
        right = "a steady one, which protocol starts, stops or turns back and forth"
        raise SceneError("flow", "changes in time", right)
    gradient = np.asarray(flow.gradient(np.asarray(position, dtype=np.float64)))
    strain = 0.5 * (gradient + gradient.T)
    rate = float(np.sqrt(2.0 * np.sum(strain * strain)))
    if rate <= 1e-14 * float(np.linalg.norm(gradient)) or rate == 0.0:
        raise SceneError("flow", "strains nothing", "a flow with a strain rate, such as shear")
    return LinearFlow(gradient, rate, ShearFrame.of(gradient).shear)


class Dilute:
    """A dilute suspension of a body in a homogeneous flow: what `rheology` and `langevin` share.

    keys: of section `rheology` of a case, which checks them, None for those that are left out.
    numbers: Peclet numbers as they were given, () or (n,). Raises SceneError.
    """

    def __init__(
        self, body: Body, flow: Flow, peclet_number: ArrayLike, position: ArrayLike, **keys: Any
    ) -> None:
        if not hasattr(body, "stokes_number"):
            raise SceneError("body", f"is {body!r}", "a body such as qs.Body(0.2)")
        keys |= {"peclet_number": np.atleast_1d(np.asarray(peclet_number, dtype=object)).tolist()}
        if keys["times"] is not None:
            keys["times"] = np.atleast_1d(np.asarray(keys["times"])).tolist()
        try:
            asked = RheologySection.read({key: v for key, v in keys.items() if v is not None})
        except Problem as problem:
            key = ".".join(str(part) for part in problem.key if part != "langevin")
            raise SceneError(key, problem.wrong, problem.right) from None
        self.body, self.flow = body, linear_flow(flow, position)
        self.numbers: Array = np.reshape(asked.peclet_number, np.shape(peclet_number))
        cycle, instants = None, asked.times
        if asked.protocol == "oscillation":
            by_amplitude = 1.0 / (asked.amplitude or 1.0)
            cycle = asked.frequency / self.flow.rate if asked.frequency else by_amplitude
        if instants is None and asked.protocol != "steady":
            end = _STRAIN if cycle is None else 2.0 * np.pi / cycle
            instants = np.linspace(0.0, end, SAMPLES).tolist()
        times = None if instants is None else np.array(instants)
        self.history = History(asked.protocol, times, cycle)

    @cached_property
    def formed(self) -> tuple[Particle, float]:
        """Its particles, and the relative error that is known of them."""
        return particle_of(self.body)

    @cached_property
    def transport(self) -> Transport:
        """The flow of the orientations."""
        return Transport(self.flow, self.formed[0].linear)

    @property
    def summary(self) -> dict[str, Any]:
        """What is told of it."""
        particle = self.formed[0]
        return {
            "protocol": self.history.protocol,
            "rate": self.flow.rate,
            "viscosity_at_rest": particle.viscosity_at_rest,
            "viscosity_of_isotropic": particle.viscosity_of_isotropic,
            "frequency": self.history.cycle,
            "stresslet_numbers": particle.stresslet.tolist(),
        }


def rheology(
    body: Body,
    flow: Flow,
    peclet_number: ArrayLike = 10.0,
    *,
    protocol: Protocol = "steady",
    times: ArrayLike | None = None,
    amplitude: float | None = None,
    frequency: float | None = None,
    orientations: ArrayLike | str = "isotropic",
    weights: ArrayLike | None = None,
    settling: float = 400.0,
    tolerance: float = 1e-8,
    position: ArrayLike = (0.0, 0.0, 0.0),
) -> Rheology:
    """Stress of a dilute suspension of a body in a homogeneous flow.

    peclet_number: the flow's rate sqrt(2 E:E) over the rotary diffusivity, a number or (n,);
    infinite: without Brownian motion, where the axes remember how they were at the start, that is
    orientations: "isotropic", or axes (n, 3) with weights (n,). A steady state is then a mean over
    a long time. protocol: "steady"; "startup" of the flow from rest, with isotropic orientations;
    "cessation" of the steady flow; "oscillation" with the strain amplitude sin(w t), in its
    periodic state: give the strain amplitude or w, the other one is rate/that. times: in units of
    1/rate. tolerance: of the stress, relative. Bodies with inertia take an infinite Peclet number,
    a steady flow and axes at the start; each is given the strain `settling` to come to its
    attractor, over whose last turn the mean is taken.

    >>> import numpy as np, qbxstokes as qs
    >>> found = qs.rheology(qs.Body(0.2), qs.flow("shear"), peclet_number=[1e-4, 1.0, 100.0])
    >>> np.round(found.intrinsic_viscosity, 6)
    array([5.806206, 5.748197, 3.108525])
    """
    dilute = Dilute(
        body,
        flow,
        peclet_number,
        position,
        protocol=protocol,
        times=times,
        amplitude=amplitude,
        frequency=frequency,
        settling=settling,
        tolerance=tolerance,
    )
    if tolerance < 1e-12:
        raise SceneError("tolerance", f"is {tolerance:g}", "from 1e-12 to 0.1")
    numbers, homogeneous, history = dilute.numbers, dilute.flow, dilute.history
    starts = starts_of(orientations, weights, numbers)
    if np.any(body.stokes_number) and (np.any(np.isfinite(numbers)) or protocol != "steady"):
        right = "0: inertial bodies take peclet_number: inf and protocol: steady"
        raise SceneError("stokes_number", f"is {np.max(body.stokes_number):g}", right)
    if np.any(body.stokes_number):
        means = inertial_means(body, flow, starts, homogeneous.rate, settling, tolerance)
        nothing = np.zeros((3, 3))
        means |= {"brownian_stress": nothing, "distribution": None, "degree": 0}
        found = [{**means, "error_estimate": np.array(means["error_estimate"])}] * numbers.size
    else:
        found = [
            _one(dilute, float(peclet), starts, tolerance) for peclet in np.atleast_1d(numbers)
        ]
    stacked = {
        name: np.stack([one[name] for one in found]).reshape(
            numbers.shape + np.shape(found[0][name])
        )
        for name in found[0]
        if name not in ("distribution", "degree")
    }
    stacked["error_estimate"] = stacked["error_estimate"] + dilute.formed[1]
    distributions = [one["distribution"] for one in found]
    stacked.setdefault("inertial_stress", np.zeros_like(stacked["hydrodynamic_stress"]))
    stress = sum(stacked[f"{name}_stress"] for name in ("hydrodynamic", "brownian", "inertial"))
    assert not isinstance(stress, int)
    return Rheology(
        peclet_number=numbers,
        time=history.instants,
        **homogeneous.material_functions(stress),
        particle_stress=stress,
        **stacked,
        distribution=distributions if numbers.ndim else distributions[0],
        summary={**dilute.summary, "degree": [one["degree"] for one in found]},
    )


def starts_of(orientations: ArrayLike | str, weights: ArrayLike | None, numbers: Array) -> Starts:
    """How the axes are at the start, which only those without Brownian motion remember."""
    if isinstance(orientations, str):
        if orientations != "isotropic" or weights is not None:
            right = "isotropic, or axes (n, 3) with weights (n,)"
            raise SceneError("orientations", f"are {orientations}", right)
        return Starts()
    if np.any(np.isfinite(numbers)):
        right = "peclet_number: inf, or isotropic orientations"
        raise SceneError("orientations", "are forgotten by Brownian motion", right)
    right = "isotropic, or axes (n, 3) with weights (n,)"
    axes = np.atleast_2d(as_numbers("orientations", orientations, right))
    lengths = np.linalg.norm(axes, axis=-1)
    if axes.ndim != 2 or axes.shape[1] != 3 or not len(axes) or not np.all(lengths > 0.0):
        raise SceneError("orientations", f"have shape {axes.shape}", "axes (n, 3), none of them 0")
    share = None if weights is None else np.asarray(weights, dtype=np.float64)
    if share is not None and (
        share.shape != (len(axes),) or np.any(share < 0.0) or not share.any()
    ):
        raise SceneError("weights", f"have shape {share.shape}", f"({len(axes)},), none below 0")
    return Starts(axes / lengths[:, None], share)


def _one(dilute: Dilute, peclet: float, starts: Starts, tolerance: float) -> dict[str, Any]:
    """Stresses, moments and distribution at one Peclet number."""
    (particle, _), transport, history = dilute.formed, dilute.transport, dilute.history
    if np.isinf(peclet):
        return _without_diffusion(dilute, starts, tolerance)
    diffusivity, rates = 1.0 / peclet, history.rates[..., None, None] * transport.flow.strain

    def computed(degree: int) -> tuple[dict[str, Any], Array]:
        second, fourth, last = _moments(transport, diffusivity, history, degree, tolerance)
        flowing = particle.hydrodynamic_stress(second, fourth, rates)
        brownian = particle.brownian_stress(second, diffusivity)
        parts = {
            "hydrodynamic_stress": flowing,
            "brownian_stress": brownian,
            "order_tensor": second,
            "distribution": last,
            "degree": degree,
        }
        return parts, flowing + brownian

    start = transport.first_degree(peclet, tolerance)
    parts, _, change = converged(computed, start, tolerance)
    return {**parts, "error_estimate": np.array(change)}


def _moments(
    transport: Transport, diffusivity: float, history: History, degree: int, tolerance: float
) -> tuple[Array, Array, Distribution]:
    """<pp>, <pppp> at the instants, and the last density, truncated at a degree."""
    instants = history.instants
    if instants is None:
        density = transport.steady(diffusivity, degree)
        return *density.moments(), density
    evolution = Evolution(transport, diffusivity, degree, tolerance)
    basis, axes = evolution.operators[0], transport.frame[0]
    if history.protocol == "cessation":  # without flow every degree decays by itself
        decay = np.exp(diffusivity * np.outer(evolution.operators[2], instants))
        states = transport.steady(diffusivity, degree).coefficients[:, None] * decay
    else:
        start = isotropic(basis)
        if history.cycle is not None:
            start = evolution.periodic(2.0 * np.pi / history.cycle, history.rate)
        states = evolution.run(start, instants, history.rate)
    second, fourth = basis.moments(states)
    second = axes.T @ second @ axes
    fourth = np.einsum("ai,bj,ck,dl,tabcd->tijkl", axes, axes, axes, axes, fourth, optimize=True)
    return second, fourth, Distribution(basis, axes, states[:, -1])


def _without_diffusion(dilute: Dilute, starts: Starts, tolerance: float) -> dict[str, Any]:
    """The same without Brownian motion: where the axes are follows from the strain alone."""
    (particle, _), transport, history = dilute.formed, dilute.transport, dilute.history
    matrix, instants, change = transport.matrix, history.instants, 0.0
    if instants is None or history.protocol == "cessation":
        (second, fourth), change, strains = orbits.long_time(matrix, starts, tolerance)
        shape = history.rates.shape
        second = np.broadcast_to(second, (*shape, 3, 3))
        fourth = np.broadcast_to(fourth, (*shape, 3, 3, 3, 3))
    else:
        strains = history.strain(instants)
        second, fourth = orbits.transient(matrix, strains, starts)
        strains = strains[-1:]
    distribution = None
    if starts.axes is None and len(strains):
        distribution = orbits.advected(matrix, strains)
    rates = history.rates[..., None, None] * transport.flow.strain
    flowing = particle.hydrodynamic_stress(second, fourth, rates)
    return {
        "hydrodynamic_stress": flowing,
        "brownian_stress": np.zeros_like(flowing),
        "order_tensor": second,
        "distribution": distribution,
        "degree": 0,
        "error_estimate": np.array(change),
    }
