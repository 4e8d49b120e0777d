"""Section `brownian`: random turns, and on request random displacements, of bodies that move."""

from typing import Annotated

from qbxstokes.case.model import Positive, Section, key, whole


class Brownian(Section):
    """Rotary and translational diffusion of bodies without inertia, in sweeps."""

    rotary_diffusivity: Positive = key("of the axis, in 1/time", example=0.1)
    translation: bool = key(
        "displace the bodies as well, by their own mobility (in sweeps of motions)", False
    )
    step: Positive | None = key(
        "longest time from one random turn to the next; unset: 0.05 over the flow's rate or the "
        "diffusivity. With store: statistics it is the spacing of the series",
        None,
        0.02,
    )
    seed: Annotated[int, whole(ge=0, lt=2**63)] = key("of the random numbers", 0)
