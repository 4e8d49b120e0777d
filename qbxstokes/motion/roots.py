"""The root of a function between two places where it has different signs."""

from collections.abc import Callable

_ITERATIONS = 60
_EPSILON = 2.0**-50


def root(function: Callable[[float], float], a: float, b: float, fa: float, fb: float) -> float:
    """Zero of a function between a and b, where it has the values fa and fb of different signs.

    Inverse quadratic interpolation safeguarded by bisection (T. R. Chandrupatla 1997, Adv. Eng.
    Softw. 28, 145); to rounding of the argument.
    """
    if fa == 0.0 or fb == 0.0:
        return a if fa == 0.0 else b
    t, best = fa / (fa - fb), a  # the first guess is the secant's
    for _ in range(_ITERATIONS):
        x = a + t * (b - a)
        fx = function(x)
        if fx == 0.0:
            return x
        if (fx > 0.0) == (fa > 0.0):
            c, fc = a, fa
        else:
            c, b, fc, fb = b, a, fb, fa
        a, fa = x, fx
        best = a if abs(fa) < abs(fb) else b
        if a == b:
            return best
        nearest = (_EPSILON * abs(best) + 1e-300) / abs(b - a)
        if nearest >= 0.5:
            return best
        xi, phi = (a - b) / (c - b), (fa - fb) / (fc - fb)
        t = 0.5
        if phi * phi < xi and (1.0 - phi) ** 2 < 1.0 - xi:
            t = fa / (fb - fa) * fc / (fb - fc)
            t += (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
        t = min(1.0 - nearest, max(nearest, t))
    return best
