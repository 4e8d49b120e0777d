"""Numbers of the stresslet of a spheroid in a flow, by closed forms.

G. B. Jeffery 1922, Proc. R. Soc. A 102, 161; G. K. Batchelor 1970, J. Fluid Mech. 41, 545; S. Kim &
S. J. Karrila 1991, Microhydrodynamics, section 3.3. The stresslet is
S = oint sym-traceless(x (sigma.n)) dS with the traction on the body, in units of mu c^3/tau. With
p the axis, E the strain rate, w = E p - p (p.E.p), E_perp = (I - pp) E (I - pp),

    S = S0 (3/2) (p.E.p) (pp - I/3) + S1 (p w + w p) + S2 [E_perp + (p.E.p) (I - pp)/2]

for a body free of torque, and with S1 + zeta beta^2/2 in the place of S1 for one that is held
(zeta the transverse resistance to rotation, beta = (1 - k^2)/(1 + k^2)).
"""

import math

from qbxstokes.reference.jeffery import rotation_resistance

# Below this 1 - k^2 or 1 - 1/k^2 the integrals are summed as series.
_SERIES, _TERMS = 0.7, 120


def stresslet_numbers(k: float) -> tuple[float, float, float]:
    """(S0, S1, S2) of a free spheroid with semi-axes (k, k, 1); 20 pi/3 thrice for a sphere.

    From Jeffery's integrals, with V = 4 pi k^2/3 and the integrals over 0 < t < inf:
    S0 = 4 V/(3 k^2 int t dt (k^2+t)^-2 (1+t)^(-3/2)), S1 = 4 V/(k^2 (1+k^2) int dt (k^2+t)^-2
    (1+t)^(-3/2)), S2 = 2 V/(k^4 int dt (k^2+t)^-3 (1+t)^(-1/2)). With 1 + t = 1/s^2 they become
    moments of 1/(1 + (k^2-1) s^2) over 0 < s < 1.
    """
    square = k * k
    fourth = moment(2, 2, k)
    axial = 16.0 * math.pi / 9.0 / (2.0 * (moment(1, 2, k) - fourth))
    if abs(k - 1.0) > 0.5:
        # Without the difference: int s^2 (1 - s^2)/(1 + m s^2)^2 = ((3 + m) f - 3)/(2 m^2).
        m = square - 1.0
        axial = 16.0 * math.pi / 9.0 * m * m / ((3.0 + m) * _base(k) - 3.0)
    mixed = 16.0 * math.pi / 3.0 / (1.0 + square) / (2.0 * fourth)
    across = 8.0 * math.pi / 3.0 / (square * 2.0 * moment(2, 3, k))
    return axial, mixed, across


def held_number(k: float) -> float:
    """S1 of the held spheroid, (20 pi/3) Y^M of Kim & Karrila: S1 + zeta beta^2/2."""
    beta = (1.0 - k * k) / (1.0 + k * k)
    return stresslet_numbers(k)[1] + 0.5 * rotation_resistance(k)[0] * beta * beta


def moment(a: int, b: int, k: float) -> float:
    """int_0^1 s^(2a) (1 + (k^2-1) s^2)^-b ds for (a, b) = (1, 2), (2, 2) or (2, 3)."""
    square = k * k
    m = square - 1.0
    if abs(m) < _SERIES or (m > 0.0 and m / square < _SERIES):
        return _series(a, b, m)
    f = _base(k)
    if (a, b) == (1, 2):
        return (f - 1.0 / square) / (2.0 * m)
    if (a, b) == (2, 2):
        return (1.0 + 0.5 / square - 1.5 * f) / (m * m)
    return (0.375 * f - 0.625 / square + 0.25 / square**2) / (m * m)


def _base(k: float) -> float:
    """int_0^1 ds/(1 + (k^2-1) s^2)."""
    m = k * k - 1.0
    if m > 0.0:
        return math.atan(math.sqrt(m)) / math.sqrt(m)
    # artanh(r) with 1 - r^2 = k^2 exactly.
    r = math.sqrt(-m)
    return math.log((1.0 + r) / k) / r if r > 0.0 else 1.0


def _series(a: int, b: int, m: float) -> float:
    """The same as (1/(2a+1)) 2F1(b, a+1/2; a+3/2; -m), after Pfaff's transformation for m > 0."""
    c = a + 0.5
    first, z, factor = float(b), -m, 1.0
    if m > 0.0:  # (1+m)^-b 2F1(b, 1; a+3/2; m/(1+m))
        z, factor = m / (1.0 + m), (1.0 + m) ** -b
    second = 1.0 if m > 0.0 else c
    total, term = 0.0, 1.0
    for n in range(_TERMS):
        total += term
        term *= (first + n) * (second + n) / ((c + 1.0 + n) * (1.0 + n)) * z
    return factor * total / (2.0 * a + 1.0)
