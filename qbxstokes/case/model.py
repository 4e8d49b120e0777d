"""Sections of a case: keys with what reads them, defaults and meanings; all faults told at once.

    class Body(Section):
        aspect_ratio: Annotated[float, number(gt=0)] = key("k = a/c", example=0.5)

What reads a key follows from its annotation: a plain type, a `Literal`, `| None`, a section, or the
reader that `Annotated` names. Numbers may be arithmetic, every fault is found, a misspelt key is
told with the nearest one, and a section knows which of its keys were given: that takes a walk of
our own over data and declarations, whatever library validates. What were left to the library are
the bounds and words of `number` and `choice` here; translating its messages takes as many lines,
and its import takes longer (msgspec: half of what the whole package takes).
"""

from __future__ import annotations

import inspect
import operator
import re
import types
import typing
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, Self

from qbxstokes.case.values import (
    Problem,
    describe,
    gathered,
    meant,
    to_angle,
    to_integer,
    to_number,
    to_text,
)
from qbxstokes.expressions import LARGEST

# -- readers --------------------------------------------------------------------------------------

_BOUNDS: dict[str, tuple[str, Callable[[Any, Any], bool], str]] = {
    "gt": (">", operator.gt, "exclusiveMinimum"),
    "ge": (">=", operator.ge, "minimum"),
    "lt": ("<", operator.lt, "exclusiveMaximum"),
    "le": ("<=", operator.le, "maximum"),
}


@dataclass(eq=False)
class Reader:
    """How a value is read: a function that returns ours or raises Problem, and its JSON Schema.

    section: which one it opens; listed: whether as entries of a list. words: those that it is a
    choice of.
    """

    read: Callable[[Any], Any]
    json: dict[str, Any]
    section: type[Section] | None = None
    words: tuple[str, ...] = ()
    listed: bool = False


def number(convert: Callable[[Any], Any] = to_number, **bounds: float) -> Reader:
    """A number within bounds (gt, ge, lt, le), written as one or as arithmetic."""

    def read(value: Any) -> Any:
        converted = convert(value)
        for name, bound in bounds.items():
            sign, holds, _ = _BOUNDS[name]
            if not holds(converted, bound):
                raise Problem(f"is {describe(converted)}", f"must be {sign} {bound:g}")
        return converted

    limits = {_BOUNDS[name][2]: bound for name, bound in bounds.items()}
    if convert is to_integer:
        return Reader(read, {"type": "integer", **limits})
    return Reader(read, {"anyOf": [{"type": "number", **limits}, {"type": "string"}]})


def whole(**bounds: float) -> Reader:
    """A whole number within bounds."""
    return number(to_integer, **bounds)


def choice(*words: str) -> Reader:
    """One of some words."""
    right = f"one of {', '.join(words)}"

    def read(value: Any) -> str:
        if value in words:
            return str(value)
        wrong = f"{describe(value)} is not a choice"
        word = value if isinstance(value, str) else ""
        raise Problem(wrong, meant(word, words, right, f" ({right})"))

    return Reader(read, {"enum": list(words)}, words=words)


def several(entry: Any, like: str = "") -> Reader:
    """A list; with an example such as '[x1, x2]', of as many entries as that."""
    count, right = like.count(",") + 1, "a list is expected"
    if like:
        right = f"{count} numbers are expected: {like}"

    def read(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, (list, tuple)):
            raise Problem(f"is {describe(value)}", right)
        if like and len(value) != count:
            raise Problem(f"has {len(value)} entries", right)
        return tuple(gathered(lambda place: entry.read(value[place]), range(len(value))))

    return Reader(read, {"type": "array", "items": entry.json})


def refined(
    reader: Reader, holds: Callable[[Any], Any], right: str, wrong: str = "", **json: Any
) -> Reader:
    """What another reader reads, where something holds."""

    def read(value: Any) -> Any:
        value = reader.read(value)
        if not holds(value):
            raise Problem(wrong or f"is {describe(value)}", right)
        return value

    return Reader(read, reader.json | json)


def some(entry: Any) -> Reader:
    """A list of one entry at least."""
    return refined(several(entry), len, "number of entries >= 1", minItems=1)


def pointing(vector: Reader) -> Reader:
    """A vector that is not zero."""
    return refined(vector, any, "any non-zero vector", "is zero and has no direction")


def maybe(inner: Any) -> Reader:
    """What another reader reads, or nothing."""

    def read(value: Any) -> Any:
        return None if value is None else inner.read(value)

    json = {"anyOf": [inner.json, {"type": "null"}]}
    return Reader(read, json, inner.section, inner.words, inner.listed)


TEXT = Reader(to_text, {"type": "string"})
NAME = refined(TEXT, len, "one character at least", minLength=1)
VECTOR = several(number(), "[x1, x2, x3]")
_BOOLEAN = Reader(lambda value: value, {"type": "boolean"})
TRUTH = refined(_BOOLEAN, lambda value: isinstance(value, bool), "write true or false")
_PLAIN = {float: number(), str: TEXT, bool: TRUTH}

Vector = Annotated[tuple[float, float, float], VECTOR]
Direction = Annotated[tuple[float, float, float], pointing(VECTOR)]
Angle = Annotated[float, number(to_angle)]
Positive = Annotated[float, number(gt=0, ge=1.0 / LARGEST)]
_NO_LESS = f"0, or >= {1.0 / LARGEST:g}"
NotNegative = Annotated[
    float, refined(number(ge=0), lambda value: value == 0 or value >= 1.0 / LARGEST, _NO_LESS)
]
Share = Annotated[float, number(gt=0, lt=1)]
Tolerance = Annotated[float, number(gt=0, le=0.1)]
Instants = Annotated[tuple[float, ...], some(number())]


def reader_of(hint: Any) -> Any:
    """What reads a key with that annotation: a reader, or a section."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        return arguments[1]
    if origin is Literal:
        return choice(*arguments)
    if origin in (typing.Union, types.UnionType):
        return maybe(reader_of(arguments[0]))
    return _PLAIN.get(hint, hint)


# -- keys and sections ----------------------------------------------------------------------------


@dataclass(eq=False)
class Key:
    """A key of a section: what it means, its default, an example; `hint`, its annotation."""

    meaning: str
    default: Any = ...
    example: Any = None
    hint: Any = None

    @property
    def required(self) -> bool:
        """Whether it must be given."""
        return self.default is ...

    @cached_property
    def reader(self) -> Reader:
        """What reads the value; made when it is first needed."""
        return reader_of(self.hint)

    def lack(self, name: str) -> Any:
        """Raise Problem: the key is missing."""
        below = ", ".join(self.reader.section.declared) if self.reader.section else ""
        right = f"{self.meaning}, with the keys {below}" if below else self.meaning
        example = "" if self.example is None else f"; for example {name}: {self.example}"
        raise Problem("is missing", right + example)


# What stands in a section: its type is that of the annotation.
key: Callable[..., Any] = Key


class Section(types.SimpleNamespace):
    """One section of the case: immutable, without unknown keys, every key described.

    A subclass may define `_prepare`, which sees the data before they are read, and `_check`, which
    sees the section whose keys are all right by themselves; both raise Problem.
    """

    __slots__ = ("given_keys",)  # apart from the values: equal are sections that mean the same
    given_keys: frozenset[str]
    declared: ClassVar[dict[str, Key]] = {}
    is_open: ClassVar[bool]
    elsewhere: ClassVar[dict[str, Any]]
    # What a section is as a reader, besides `read`.
    json: ClassVar[dict[str, Any]]
    section: ClassVar[type[Section]]
    words: ClassVar[tuple[str, ...]] = ()
    listed: ClassVar[bool] = False

    def __init_subclass__(cls, is_open: bool = False, **elsewhere: tuple[str, str]) -> None:
        """Collect the keys, those of the parent first.

        is_open: keep keys that are not declared, in `extra`, rather than refuse them. elsewhere:
        keys that are not there, with what is wrong with them and what would be right.
        """
        cls.json, cls.section = {"$ref": f"#/$defs/{cls.__name__}"}, cls
        cls.declared, cls.elsewhere, cls.is_open = dict(cls.declared), elsewhere, is_open
        hints = inspect.get_annotations(cls, eval_str=True)
        for name, value in list(vars(cls).items()):
            if isinstance(value, Key):
                value.hint = hints[name]
                cls.declared[name] = value
                delattr(cls, name)

    def __init__(self, /, **values: Any) -> None:
        """The section with these values, not checked, and defaults for the rest."""
        defaults = {name: declared.default for name, declared in self.declared.items()}
        super().__init__(**defaults | values)
        object.__setattr__(self, "given_keys", frozenset(values))

    @property
    def extra(self) -> dict[str, Any]:
        """The keys that are not declared."""
        known = type(self).declared
        return {name: value for name, value in vars(self).items() if name not in known}

    @classmethod
    def read(cls, data: Any) -> Self:
        """The section that plain data describe; raises Problem with every fault."""
        data = cls._prepare(data)
        if not isinstance(data, dict):
            right = f"keys are expected below it: {', '.join(cls.declared)}"
            if isinstance(data, str) and re.match(r"\w+:\S", data):
                right += "; put a space after the colon"
            raise Problem(f"is {describe(data)}", right)

        def value(name: str) -> Any:
            declared = cls.declared.get(name)
            if declared:
                return declared.reader.read(data[name]) if name in data else declared.lack(name)
            if cls.is_open:
                return data[name]
            known = meant(name, cls.declared, f"known here: {', '.join(cls.declared)}")
            wrong, right = cls.elsewhere.get(name, ("unknown key", known))
            raise Problem(wrong, right, unknown=True)

        names = [n for n in {**cls.declared, **data} if n in data or cls.declared[n].required]
        section = cls(**dict(zip(names, gathered(value, names), strict=True)))
        section._check()
        return section

    @classmethod
    def _prepare(cls, data: Any) -> Any:
        return data

    def _check(self) -> None:
        """Nothing to agree on."""

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{type(self).__name__} is immutable")


def switch(section: type[Section]) -> Reader:
    """A section that may be written as true, with its defaults, or as false: none."""

    def read(value: Any) -> Section | None:
        return section.read({} if value is True else value) if value not in (None, False) else None

    return Reader(read, {"anyOf": [{"type": ["boolean", "null"]}, section.json]}, section)
