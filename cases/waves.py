"""Linear waves on deep water, far from the surface of which a body is."""

import math


def velocity(x, y, z, t, height, number):
    """Velocity at a point: a potential flow that moves along x; times are those of its phase."""
    speed = height * math.exp(number * y)
    phase = number * x - t
    return speed * math.cos(phase), speed * math.sin(phase), 0.0
