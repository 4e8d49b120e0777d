"""Which pictures a result calls for, and one of them by its name."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from qbxstokes.errors import CaseError
from qbxstokes.plots import ensemble, field, motion, rheology, style, sweep
from qbxstokes.plots.picture_source import ResultLike, is_motion
from qbxstokes.plots.series import draw_quantity, panels
from qbxstokes.plots.style import Drawings
from qbxstokes.quantities import RECORDABLE


def kinds(
    result: ResultLike, wanted: Sequence[str] = (), roles: Mapping[str, Any] | None = None
) -> Drawings:
    """Kind and drawing of each picture of a result, or of those wanted.

    A motion has those of its quantities as well, by their names. roles: x, y, by, value and scale
    of a sweep. Raises CaseError for kinds or columns that are not there.
    """
    if result.task == "sweep":
        return sweep.drawings(result, wanted, roles)  # type: ignore[arg-type]
    if roles:
        raise CaseError(f"{result.path}: is not a sweep, so it has no table whose columns to draw")
    found: Drawings = motion.drawings(result) if is_motion(result) else {}
    found |= field.drawings(result) | rheology.drawings(result) | ensemble.drawings(result)
    for kind in wanted:
        if kind in result.arrays and kind in RECORDABLE and is_motion(result):
            whole = [partial(draw_quantity, result=result, name=kind)]
            found.setdefault(kind, partial(motion.stacked, panels(result, [kind]) or whole))
        elif kind not in found:
            there = ", ".join(found) or "no pictures"
            raise CaseError(f"{result.path}: nothing to draw as {kind!r}; there are {there}")
    if not found:
        raise CaseError(f"{result.path}: holds nothing that calls for a picture")
    return {kind: found[kind] for kind in wanted} if wanted else found


def plot(result: ResultLike, kind: str, ax: Any, roles: Mapping[str, Any]) -> Any:
    """One picture: a figure, or `ax` again, drawn into; see `Result.plot`."""
    draw = next(iter(kinds(result, [kind] if kind else [], roles).values()))
    if ax is None:
        with style.styled():
            return draw()
    axes = np.ravel(ax).tolist()
    if len(axes) == 1 and kind in RECORDABLE and is_motion(result):
        draw_quantity(axes[0], result, kind)
        return ax
    with style.into(axes):
        draw()
    return ax
