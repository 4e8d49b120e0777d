"""Section `statistics`: what is kept of an ensemble of paths in the place of their motions."""

from typing import Annotated

from qbxstokes.case.model import Section, choice, key, number, some, whole

RATES = ("tumbling", "spinning", "cos_vorticity")
STRAINS = ("cos_strain_1", "cos_strain_2", "cos_strain_3")


class Statistics(Section):
    """Moments, distributions, means in time and correlations of axes along paths.

    tumbling and spinning are squares of rates, |dp/dt|^2 and (Omega.p)^2; cos_vorticity and
    cos_strain_1 (most stretching) to 3 are |cos| of the angle of the axis p with these directions.
    """

    quantities: Annotated[tuple[str, ...], some(choice(*RATES, *STRAINS))] = key(
        "what is looked at: " + ", ".join((*RATES, *STRAINS)), RATES
    )
    stresses: bool = key(
        "mean stress of the particles, its Brownian part, and the viscosity it makes", False
    )
    every: Annotated[int, whole(ge=1)] = key("samples from one look to the next", 1)
    discard: Annotated[float, number(ge=0, lt=1)] = key(
        "part of the time left out, from the start", 0.0
    )
    bins: Annotated[int, whole(ge=2, le=100_000)] = key("of each distribution", 200)
    correlation: Annotated[int, whole(ge=0, le=1000)] = key(
        "lags of the axis's correlation, spaced in equal proportion", 32
    )
    keep: Annotated[int, whole(ge=0, le=256)] = key(
        "paths, the first ones, whose axes are stored at every look", 0
    )
    seed: Annotated[int, whole(ge=0)] = key("of axes at random", 0)
    sampling: bool = key(
        "also follow the first paths on every other sample, to tell what the sampling leaves", True
    )
