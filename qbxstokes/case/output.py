"""Section `output`: where the results go."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from qbxstokes.case.base import Boolean, to_text
from qbxstokes.case.model import Convert, Field, Problem, Section
from qbxstokes.quantities import MOTION

if TYPE_CHECKING:
    Sampled = str
else:
    Sampled = Literal[tuple(MOTION)]


def _path(value: Any) -> str:
    name = to_text(value)
    if name.endswith("/"):
        raise Problem("names a directory", "a file name such as result.h5")
    return name


class Output(Section):
    """The result file."""

    file: Annotated[str, Convert(_path), Field(min_length=1, max_length=4000)] | None = Field(
        default=None,
        description="result file, relative to the working directory; unset: the case's name + .h5",
        examples=["result.h5"],
    )
    overwrite: Boolean = Field(
        default=False, description="replace an existing result; otherwise a free name is numbered"
    )
    fields: Annotated[tuple[Sampled, ...], Field(min_length=1)] | None = Field(
        default=None,
        description="quantities to store besides time; unset: all",
        examples=[["position", "axis"]],
    )
