"""The declared sections themselves: types, bounds, faults, and what is left alone."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest

from qbxstokes.case.model import MISSING, Convert, Field, Invalid, Problem, Section


def half(value: Any) -> float:
    if value == "odd":
        raise Problem("is odd", "an even one")
    return value / 2


class Inner(Section):
    word: Literal["left", "right"] = Field(default="left", description="a side")


class Outer(Section):
    number: Annotated[float, Convert(half), Field(gt=0, le=3)] = Field(description="a number")
    count: int | None = Field(default=None, description="how many")
    pair: tuple[float, float] = Field(default=(0.0, 1.0), description="two numbers")
    names: Annotated[tuple[str, ...], Field(min_length=1)] = Field(
        default=("a",), description="names"
    )
    options: dict[str, str | bool] = Field(default={}, description="options")
    inner: Inner = Field(default=Inner(), description="a section")

    def _check(self) -> None:
        if self.count == 13:
            raise Problem("is unlucky", "another", ("count",))


class Open(Section):
    model_open = True
    kind: str = Field(description="a kind")


def faults(data: Any) -> list[tuple[str, Any]]:
    with pytest.raises(Invalid) as caught:
        Outer.model_validate(data)
    return [(fault.kind, ".".join(map(str, fault.key))) for fault in caught.value.faults]


def test_values_defaults_and_plain_data() -> None:
    outer = Outer.model_validate({"number": 4, "names": ["b", "c"], "inner": {"word": "right"}})
    assert (outer.number, outer.count, outer.pair, outer.names) == (
        2.0,
        None,
        (0.0, 1.0),
        ("b", "c"),
    )
    assert outer.inner == Inner(word="right") != Inner()
    assert outer.model_fields_set == {"number", "names", "inner"}
    assert Outer.model_validate({"number": 4}).inner is Outer.model_fields["inner"].default
    assert Outer.model_fields["number"].default is MISSING
    assert outer.model_dump(exclude=("options",)) == {
        "number": 2.0,
        "count": None,
        "pair": [0.0, 1.0],
        "names": ["b", "c"],
        "inner": {"word": "right"},
    }


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (3, [("section", "")]),
        ({}, [("missing", "number")]),
        ({"number": "odd"}, [("value", "number")]),
        ({"number": 0}, [("value", "number")]),
        ({"number": 8}, [("value", "number")]),
        ({"number": 1, "count": 1.5}, [("value", "count")]),
        ({"number": 1, "count": True}, [("value", "count")]),
        ({"number": 1, "count": 13}, [("value", "count")]),
        ({"number": 1, "pair": 1}, [("list", "pair")]),
        ({"number": 1, "pair": [1]}, [("list", "pair")]),
        ({"number": 1, "pair": [1, "x"]}, [("value", "pair.1")]),
        ({"number": 1, "names": []}, [("value", "names")]),
        ({"number": 1, "names": ["a", 1]}, [("value", "names.1")]),
        ({"number": 1, "options": []}, [("section", "options")]),
        ({"number": 1, "options": {"a": "x", "b": 1}}, [("value", "options.b")]),
        ({"number": 1, "inner": None}, [("section", "inner")]),
        ({"number": 1, "inner": {"word": "up"}}, [("choice", "inner.word")]),
        ({"inner": {"wird": "left"}}, [("missing", "number"), ("unknown", "inner.wird")]),
    ],
)
def test_every_fault_is_found_where_it_is(data: Any, expected: list[tuple[str, str]]) -> None:
    assert faults(data) == expected


def test_sections_are_immutable_and_keys_are_those_declared() -> None:
    with pytest.raises(AttributeError, match="Inner is immutable"):
        Inner().word = "right"
    assert Open.model_validate({"kind": "x", "size": 2}).model_dump() == {"kind": "x", "size": 2}


def test_nothing_is_built_for_keys_that_are_not_given() -> None:
    class Late(Section):
        given: int = Field(default=1, description="read")
        other: Annotated[int, Field(ge=0)] = Field(default=1, description="left alone")

    Late.model_validate({"given": 2})
    assert set(Late.model_checks) == {"given"}
