"""The declared sections themselves: types, bounds, faults, and what is left alone."""

from typing import Annotated, Any, Literal

import pytest

from qbxstokes.case.document import plain
from qbxstokes.case.model import (
    TEXT,
    Reader,
    Section,
    key,
    number,
    refined,
    several,
    some,
    whole,
)
from qbxstokes.case.values import Problem


def half(value: Any) -> float:
    if value == "odd":
        raise Problem("is odd", "an even one")
    return float(value / 2)


Half = Annotated[float, number(half, gt=0, le=3)]
Pair = Annotated[tuple[float, float], several(number(), "[a, b]")]
Names = Annotated[
    tuple[str, ...], some(refined(TEXT, lambda text: len(text) < 4, "three characters at most"))
]


class Inner(Section):
    word: Literal["left", "right"] = key("a side", "left")


class Outer(Section, later=("is not there yet", "wait")):
    size: Half = key("a number", example=2)
    count: Annotated[int, whole()] | None = key("how many", None)
    pair: Pair = key("two numbers", (0.0, 1.0))
    names: Names = key("names", ("a",))
    answer: bool = key("yes or no", True)
    own: Annotated[dict[str, Any], Reader(dict, {"type": "object"})] = key("options", {})
    inner: Inner = key("a section", Inner())

    def _check(self) -> None:
        if self.count == 13:
            raise Problem("is unlucky", "another", ("count",))


class Open(Section, is_open=True):
    kind: str = key("a kind")


def faults(data: Any) -> dict[str, str]:
    with pytest.raises(Problem) as caught:
        Outer.read(data)
    found = caught.value.faults
    return {".".join(map(str, fault.key)): f"{fault.wrong}; {fault.right}" for fault in found}


def test_values_defaults_and_plain_data() -> None:
    outer = Outer.read({"size": 4, "names": ["b", "c"], "inner": {"word": "right"}})
    assert (outer.size, outer.count, outer.pair, outer.names) == (2.0, None, (0.0, 1.0), ("b", "c"))
    assert outer.inner == Inner(word="right") != Inner()
    assert outer.given_keys == {"size", "names", "inner"}
    assert outer == Outer(size=2.0, names=("b", "c"), inner=Inner(word="right"), count=None)
    assert Outer.read({"size": 4}).inner is Outer.declared["inner"].default
    assert Outer.declared["size"].default is ...
    assert plain(outer) == {
        "size": 2.0,
        "count": None,
        "pair": [0.0, 1.0],
        "names": ["b", "c"],
        "answer": True,
        "own": {},
        "inner": {"word": "right"},
    }


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (3, {"": "is 3; keys are expected below it: size, count, pair, names, answer, own, inner"}),
        ({}, {"size": "is missing; a number; for example size: 2"}),
        ({"size": "odd"}, {"size": "is odd; an even one"}),
        ({"size": 0}, {"size": "is 0; must be > 0"}),
        ({"size": 8}, {"size": "is 4; must be <= 3"}),
        ({"size": 1, "count": 1.5}, {"count": "1.5 is not a whole number; a whole number is exp"}),
        ({"size": 1, "count": True}, {"count": "is true; a whole number is expected"}),
        ({"size": 1, "count": 13}, {"count": "is unlucky; another"}),
        ({"size": 1, "pair": 1}, {"pair": "is 1; 2 numbers are expected: [a, b]"}),
        ({"size": 1, "pair": [1]}, {"pair": "has 1 entries; 2 numbers are expected: [a, b]"}),
        ({"size": 1, "pair": [1, "x"]}, {"pair.1": "'x' is not a number; write one"}),
        ({"size": 1, "names": []}, {"names": "is a list of 0 entries; number of entries >= 1"}),
        (
            {"size": 1, "names": ["a", []]},
            {"names.1": "is a list of 0 entries; a text is expected"},
        ),
        ({"size": 1, "names": ["abcd"]}, {"names.0": "is 'abcd'; three characters at most"}),
        ({"size": 1, "answer": "yes"}, {"answer": "is 'yes'; write true or false"}),
        ({"size": 1, "inner": None}, {"inner": "is empty; keys are expected below it: word"}),
        (
            {"size": 1, "inner": {"word": "rihgt"}},
            {"inner.word": "'rihgt' is not a choice; did you"},
        ),
        ({"size": 1, "later": 1}, {"later": "is not there yet; wait"}),
        (
            {"pair": [1, "x"], "inner": {"wird": "left"}},
            {
                "size": "is missing",
                "pair.1": "'x' is not a number",
                "inner.wird": "unknown key; did you mean word?",
            },
        ),
    ],
)
def test_every_fault_is_found_where_it_is(data: Any, expected: dict[str, str]) -> None:
    found = faults(data)
    assert found.keys() == expected.keys()
    for name, told in expected.items():
        assert found[name].startswith(told)


def test_sections_are_immutable_and_keys_are_those_declared() -> None:
    with pytest.raises(AttributeError, match="Inner is immutable"):
        Inner().word = "right"
    assert plain(Open.read({"kind": "x", "size": 2})) == {"kind": "x", "size": 2}
    assert plain(Open.read({"kind": "x", "self": 2, "extra": 3}))["extra"] == 3


def test_nothing_is_built_for_keys_that_are_not_given() -> None:
    class Late(Section):
        given: Half = key("read", 1.0)
        other: Half = key("left alone", 1.0)

    Late.read({"given": 2})
    assert "reader" in vars(Late.declared["given"])
    assert "reader" not in vars(Late.declared["other"])
