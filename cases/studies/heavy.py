"""A heavy spheroid in simple shear, and in a profile of weak curvature, by equations of its axis.

Nothing is integrated step by step here: small Stokes numbers by averages over Jeffery orbits, any
Stokes number by periodic solutions of the axis in the plane of shear, in which the angle itself is
the independent variable. The flow is u = (x2 + K x2^2, 0, 0), rate 1 at the centre.

With d = D3, g(d) = W d + lambda (E d - d d.E d) Jeffery's rate of the axis, s = Omega.d, b = R/J,

    P d'' = (b/St) (g(d) - d') - (J3/J1) s d' x d,   s' = (b3/St) (w.d/2 - s)        (P = I - d d)

which is the balance of angular momentum of an axisymmetric body under Jeffery's torque (Jeffery
1922). To first order in St the axis obeys d' = g - (St/R) (J1 P g' + J3 s g x d), the expansion of
Einarsson, Angilella & Mehlig 2014 (Physica D 278, 79) for particle inertia.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.integrate import solve_ivp

from qbxstokes.reference import jeffery, lamb
from qbxstokes.reference.inertial import inertia, volume

_NODES = 512  # of the average over an orbit; its integrand is analytic in the phase
# Radau IIA of three stages, as collocation: order 5, and disturbances that decay within a step
# vanish (Hairer & Wanner 1996, Solving Ordinary Differential Equations II, section IV.5).
_PLACES, _POWERS = np.array([[0.4 - np.sqrt(0.06)], [0.4 + np.sqrt(0.06)], [1.0]]), np.arange(3)
_RADAU = _PLACES ** (_POWERS + 1) / (_POWERS + 1) @ np.linalg.inv(_PLACES**_POWERS)


def shape(k):
    """lambda = (1 - k^2)/(1 + k^2)."""
    return (1.0 - k * k) / (1.0 + k * k)


def relaxation_rates(k):
    """R/inertia: translation transverse, axial, rotation transverse, axial; over St, rates."""
    transverse, axial = lamb.translation_resistance(k)
    turning, spinning = jeffery.rotation_resistance(k)
    moments = inertia(k)
    rotation = turning / float(moments[0]), spinning / float(moments[2])
    return transverse / volume(k), axial / volume(k), *rotation


def jeffery_orbit(k, constant):
    """Axis (n, 3) and its rate on an orbit at equal steps of time; constant may be infinite."""
    start = np.array([1.0, 0.0, 0.0]) if np.isinf(constant) else np.array([constant, 0.0, 1.0])
    times = jeffery.period(k) * np.arange(_NODES) / _NODES
    d = jeffery.axis_at(times, k, start / np.linalg.norm(start))
    return d, jeffery_rate(k, d)


def jeffery_rate(k, d):
    """g(d), (..., 3): rate of the axis of a free massless body in the shear of rate 1."""
    lam = shape(k)
    pull = lam * d[..., 0] * d[..., 1]
    linear = 0.5 * (1.0 + lam) * d[..., 1], -0.5 * (1.0 - lam) * d[..., 0], 0.0 * d[..., 2]
    return np.stack(linear, axis=-1) - pull[..., None] * d


def orbit_drift_coefficient(k, constant):
    """b in d(ln C)/dt = St b + O(St^2), averaged over the Jeffery orbit of constant C.

    The correction of d' is projected on grad ln C, ln C = ln(d2^2 + k^2 d1^2)/2 - ln |d3| - ln k;
    for C infinite the rate of ln |d3| is that of a small d3.
    """
    d, g = jeffery_orbit(k, constant)
    change = lag(k, d, g)
    plane = d[:, 1] ** 2 + k * k * d[:, 0] ** 2
    moved = (d[:, 1] * change[:, 1] + k * k * d[:, 0] * change[:, 0]) / plane
    if np.isinf(constant):
        # (P g')_3 = d3 (|g|^2 + pull^2 - pull') and s (g x d)_3 = d3 turn/2 for d3 -> 0.
        pull = shape(k) * d[:, 0] * d[:, 1]
        steepening = shape(k) * (g[:, 0] * d[:, 1] + d[:, 0] * g[:, 1])
        turn = d[:, 0] * g[:, 1] - d[:, 1] * g[:, 0]
        third = turn**2 + pull**2 - steepening
        moments, (turning, _) = inertia(k), jeffery.rotation_resistance(k)
        sinking = (moments[0] * third + 0.5 * moments[2] * turn) / turning
        return float(np.mean(moved + sinking))
    return float(np.mean(moved - change[:, 2] / d[:, 2]))


def lag(k, d, g):
    """What inertia adds to the rate g of the axis d, (..., 3), per Stokes number as it goes to 0.

    -(J1 P g' + J3 s g x d)/R, with the spin s of Jeffery's body.
    """
    moments, (turning, _) = inertia(k), jeffery.rotation_resistance(k)
    # The second derivative of the axis along a Jeffery orbit, exact by a complex step.
    second = jeffery_rate(k, d + 1e-30j * g).imag / 1e-30
    second = second - d * np.sum(d * second, axis=-1, keepdims=True)
    spin = -0.5 * d[..., 2:]
    return -(moments[0] * second + moments[2] * spin * np.cross(g, d)) / turning


def rolling_drift_coefficient(k):
    """b near log-rolling, C -> 0: J3 lambda/(4 R), positive for prolate bodies.

    The trace of the linear system for (d1, d2) about d = e3: (J1 (1 - lambda^2) - J3)/(4 R), and
    J1 (1 - lambda^2) = J3 (1 + lambda) for a spheroid.
    """
    turning, _ = jeffery.rotation_resistance(k)
    return float(inertia(k)[2]) * shape(k) / (4.0 * turning)


def rolling_mode(k, stokes_number):
    """Growth rate and rate of turning of a small tilt from log-rolling, for any St: an eigenvalue.

    Of those that grow fastest or decay slowest, the one with positive imaginary part.
    """
    lam, rate = shape(k), relaxation_rates(k)[2] / stokes_number
    ratio = float(inertia(k)[2] / inertia(k)[0])
    # d1'' = b ((1+lambda)/2 d2 - d1') + (J3/J1) d2'/2 and its partner; s = -1/2.
    system = np.array(
        [
            [0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [0.0, 0.5 * (1.0 + lam) * rate, -rate, 0.5 * ratio],
            [-0.5 * (1.0 - lam) * rate, 0.0, -0.5 * ratio, -rate],
        ]
    )
    # |d'|^2 d is of second order; P d'' = d'' here.
    modes = np.linalg.eigvals(system)
    return complex(max(modes, key=lambda mode: (round(mode.real, 12), mode.imag)))


@dataclass(frozen=True)
class Tumbling:
    """Periodic tumbling in the plane: p(angle) = -d(angle)/dt at nodes on [0, pi), d = (cos, sin).

    rate: mean rate of the axis, positive; half_turn: time of half a turn.
    """

    aspect_ratio: float
    stokes_number: float
    angle: np.ndarray
    speed: np.ndarray

    @property
    def half_turn(self):
        """Time of half a turn."""
        return float(np.pi * np.mean(1.0 / self.speed))

    @property
    def rate(self):
        """Mean rate of rotation: k/(1+k^2) for St = 0, 1/2 for St -> infinity.

        With t = St J1/R large, p = 1/2 + p1/t + p2/t^2 + ..., p1 = lambda/2 sin 2a, <p2> = 0, so
        that it is 1/2 - lambda^2/(4 t^2). The equation holds lambda^2 and t alone.
        """
        return float(np.pi) / self.half_turn

    def mean(self, values):
        """Average over time of values at the nodes."""
        return float(np.mean(values / self.speed) / np.mean(1.0 / self.speed))


@lru_cache(maxsize=256)
def tumbling(k, stokes_number):
    """The periodic solution of p dp/da = (b/St)(p + g), g = -1/2 + (lambda/2) cos 2a.

    Fourier collocation and Newton's method from what a body comes to in three half-turns, or, of
    heavy ones, from even rotation. stokes_number = 0 is Jeffery's orbit, p = -g.
    """
    lam, lag = shape(k), stokes_number / relaxation_rates(k)[2]
    # Odd; 1/p has poles at a distance of about min(k, 1/k) from the axis.
    n = int(np.clip(20.0 / min(k, 1.0 / k), 65, 1001)) | 1
    angle = np.pi * np.arange(n) / n
    free = 0.5 - 0.5 * lam * np.cos(2.0 * angle)
    if lag == 0.0:
        return Tumbling(k, 0.0, angle, free)
    p, before = np.full(n, 0.5), np.inf
    if lag < 2.0:

        def rate(turned, speed):
            return (0.5 - 0.5 * lam * np.cos(2.0 * turned) - speed) / (lag * speed)

        last = 3.0 * np.pi - angle[::-1]  # the angle falls
        p = solve_ivp(rate, (0.0, last[-1]), [0.5], "LSODA", last, rtol=1e-6).y[0, ::-1]
    for _ in range(30):
        slope = _derivative(n) @ p
        residual = lag * p * slope - (p - free)
        jacobian = lag * (np.diag(slope) + p[:, None] * _derivative(n)) - np.eye(n)
        change = np.linalg.solve(jacobian, residual)
        p, size = p - change, np.abs(change).max()
        # For a large lag rounding keeps the changes above any fixed bound: there they stagnate.
        if size < 1e-13 or 0.1 * before < size < 1e-8:
            break
        before = size
    if not p.min() > 0.0:
        raise ArithmeticError(
            f"no periodic solution was found for k = {k:g}, St = {stokes_number:g}"
        )
    return Tumbling(k, stokes_number, angle, p)


@lru_cache(maxsize=8)
def _derivative(n):
    """Differentiation of functions of period pi at n equal nodes, n odd (Trefethen 2000, ch. 3)."""
    j = np.arange(n)
    difference = j[:, None] - j
    with np.errstate(divide="ignore"):
        matrix = (-1.0) ** difference / np.sin(np.pi * difference / n)
    matrix[j, j] = 0.0
    return matrix


def light_rate_coefficient(k):
    """m in rate = k/(1+k^2) (1 + m (St J1/R)^2 + ...) for light bodies: s (1 - s).

    s = 2k/(1+k^2). Inserting p = f + t f f' + t^2 (f^2 f'' + 2 f f'^2) + ..., f = -g and
    t = St J1/R, in the planar equation gives the mean of 1/p as <1/f> - t^2 <f'^2/f>.
    """
    s = 2.0 * k / (1.0 + k * k)
    return s * (1.0 - s)


def tumbling_exponent(k, stokes_number):
    """Growth rate of a small d3 about tumbling, for any St > 0; -b near C infinite for small St.

    z'' + a'^2 z = -(b/St)(lambda sin a cos a z + z') + (J3/J1) s a',  s' = -(b3/St)(z/2 + s),
    over half a turn of the periodic solution (Floquet). The system is linear: equal steps in the
    angle, a 3 x 3 matrix each, are made all at once and multiplied. The error of the growth over a
    half-turn is about 1e-12.
    """
    orbit = tumbling(k, stokes_number)
    across, along = (rate / stokes_number for rate in relaxation_rates(k)[2:])
    ratio = float(inertia(k)[2] / inertia(k)[0])
    steps = 8 * orbit.angle.size
    size = np.pi / steps
    # Stages (steps, 3): the angle falls from pi to 0; p there from its Fourier series.
    waves = np.fft.rfft(orbit.speed) / orbit.angle.size * steps
    shifts = np.exp(2j * np.arange(waves.size) * (1.0 - _PLACES) * size)
    p = np.fft.irfft(waves * shifts, steps)[:, ::-1].T
    angle = np.pi - size * (np.arange(steps)[:, None] + _PLACES[:, 0])
    system = np.zeros((steps, 3, 3, 3))  # d(z, z', s)/d(-angle) = system/p
    system[..., 0, 1] = 1.0
    system[..., 1, 0] = -p * p - across * shape(k) * np.sin(angle) * np.cos(angle)
    system[..., 1, 1] = -across
    system[..., 1, 2] = -ratio * p
    system[..., 2, 0] = -0.5 * along
    system[..., 2, 2] = -along
    system /= p[..., None, None]
    stages = np.eye(9) - size * np.einsum("ij,njab->niajb", _RADAU, system).reshape(-1, 9, 9)
    product = np.linalg.solve(stages, np.tile(np.eye(3), (1, 3, 1)))[:, 6:]
    while len(product) > 1:
        even = len(product) // 2 * 2
        paired = product[1:even:2] @ product[:even:2]
        product = np.concatenate([paired, product[even:]])
    multipliers = np.linalg.eigvals(product[0])
    return float(np.log(np.max(np.abs(multipliers))) / orbit.half_turn)


def small_stokes_drift(k, constant=np.inf, profile="paraboloid"):
    """Drift velocity over K St towards higher shear on the Jeffery orbit of constant C, St -> 0.

    To first order V = U - St Theta R^-1 U', so that across the stream
    V2 = -St Theta (1/R3 - 1/R1) <d1 d2 U'>. U varies as K (1 - k^2)/3 (1 - d1^2) in a paraboloid,
    as K (1 - k^2)/3 d2^2 in a plane profile. Of a tumbling body it is, for either,
    K St Theta (1/R3 - 1/R1) (1 - k^2) k/(12 (1 + k^2)), positive for every k but 1.
    """
    d, g = jeffery_orbit(k, constant)
    across, along = lamb.translation_resistance(k)
    sign, i = (-1.0, 0) if profile == "paraboloid" else (1.0, 1)
    lag = np.mean(d[:, 0] * d[:, 1] * sign * 2.0 * d[:, i] * g[:, i])
    return float(-volume(k) * (1.0 / along - 1.0 / across) * (1.0 - k * k) / 3.0 * lag)


def large_stokes_drift(k):
    """Drift velocity times St/K of a tumbling body, St -> infinity: (R1 - R3)(1 - k^2)/(24 Theta).

    The body turns uniformly, d = (cos t/2, -sin t/2), and its velocity stays all but constant, so
    that w1 = (1-k^2)/6 cos t to leading order: the balance of <R w> along the stream, R11 varying
    as (R3 - R1)/2 cos t, sets the mean of w2.
    """
    transverse, axial = lamb.translation_resistance(k)
    return (transverse - axial) * (1.0 - k * k) / (24.0 * volume(k))


def drift(k, stokes_number, parts="both"):
    """Drift velocity over K towards higher shear of a tumbling body, weak curvature, any St.

    With w = V - u at the centre and the shear of rate 1, w' = -R(d) w/(St Theta) - w2 e1 - U' e1
    along the periodic orbit, U = (1-k^2)/3 sin^2 a; the drift is the mean of w2 (Fourier
    collocation). parts: which inertia is kept; with "rotation" alone V = U is along the stream.
    """
    if parts == "rotation":
        return 0.0
    orbit = tumbling(k, 0.0 if parts == "translation" else stokes_number)
    a, p, n = orbit.angle, orbit.speed, orbit.angle.size
    across, along = (rate / stokes_number for rate in relaxation_rates(k)[:2])
    cosine, sine = np.cos(a), np.sin(a)
    advance = -p[:, None] * _derivative(n)
    difference = along - across
    coupling = difference * cosine * sine
    first, second = (advance + np.diag(across + difference * x**2) for x in (cosine, sine))
    matrix = np.block([[first, np.diag(coupling + 1.0)], [np.diag(coupling), second]])
    push = -(1.0 - k * k) / 3.0 * 2.0 * sine * cosine * -p
    w = np.linalg.solve(matrix, np.concatenate([push, np.zeros(n)]))
    return orbit.mean(w[n:])
