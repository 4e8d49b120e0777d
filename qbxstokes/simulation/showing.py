"""What motions and suspensions show of themselves on a terminal: a few lines."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

_FEW = 9  # numbers that are shown themselves, not their shape


def shown(heading: str, arrays: Mapping[str, ArrayLike], summary: Mapping[str, Any]) -> str:
    """The heading, short arrays with their numbers, the shapes of others, names in the summary."""
    few: list[str] = []
    shapes: dict[tuple[int, ...], list[str]] = {}
    for name, value in arrays.items():
        found = np.asarray(value)
        if found.ndim < 2 and found.size <= _FEW:
            few.append(f"{name} {' '.join(f'{number:.6g}' for number in found.ravel())}")
        else:
            shapes.setdefault(found.shape, []).append(name)
    whole = [f"{', '.join(names)} {shape}" for shape, names in shapes.items()]
    told = [f"summary: {', '.join(summary)}"] if summary else []
    return "\n  ".join([f"<{heading}>", *few, *whole, *told])
