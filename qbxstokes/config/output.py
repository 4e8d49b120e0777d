"""Section `output`: where the results go."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator

from qbxstokes.config.base import Boolean, Section, Text, problem


class Output(Section):
    """The result file."""

    file: Annotated[Text, Field(min_length=1, max_length=4000)] | None = Field(
        default=None,
        description="result file, relative to the working directory; unset: the case's name + .h5",
        examples=["result.h5"],
    )
    overwrite: Boolean = Field(
        default=False, description="replace an existing result; otherwise a free name is numbered"
    )
    fields: Annotated[tuple[Text, ...], Field(min_length=1)] | None = Field(
        default=None,
        description="quantities to store besides time; unset: all",
        examples=[["position", "axis"]],
    )

    @field_validator("file")
    @classmethod
    def _is_a_path(cls, value: str | None) -> str | None:
        if value is not None and value.endswith("/"):
            raise problem("names a directory", "a file name such as result.h5")
        return value
