"""Declared sections: keys with types, defaults and descriptions, checked with all faults at once.

    class Body(Section):
        aspect_ratio: Annotated[Number, Field(gt=0)] = Field(description="k = a/c")

An annotation is `bool`, `int`, `float`, `str`, `Any`, a `Literal`, a `tuple`, a `dict` with keys of
text, another section, or a union of these; `Annotated` adds bounds (`Field`) and what turns the
user's way of writing into the type (`Convert`). Nothing is built before it is used, so that a case
pays for the sections that it names and no others: a general validation library would take longer
to load than a short motion takes to compute. The names that begin with `model_` are those of
pydantic, where they mean the same.
"""

from __future__ import annotations

import types
import typing
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal, Self

Key = tuple[str | int, ...]


class _Missing:
    """The default of a key that must be given."""

    def __repr__(self) -> str:
        return "required"


MISSING = _Missing()


class Problem(ValueError):
    """What a conversion or check raises: what is wrong, what would be right.

    key: leads from the value at hand to the one at fault.
    """

    def __init__(self, wrong: str, right: str = "", key: Key = ()) -> None:
        super().__init__(f"{wrong}; {right}")
        self.wrong, self.right, self.key = wrong, right, key


@dataclass(frozen=True)
class Fault:
    """One fault of some data: where, which value, and of which kind.

    kind: "missing", "unknown" (key), "choice", "section", "list" (expected there), "value". `right`
    says what is expected, for a choice the words; `wrong` is empty where the value itself says it.
    """

    kind: Literal["missing", "unknown", "choice", "section", "list", "value"]
    key: Key
    value: Any = None
    wrong: str = ""
    right: str = ""
    choices: tuple[str, ...] = ()


class Invalid(Exception):
    """Data that are no such section; `faults` holds one entry or more."""

    def __init__(self, faults: list[Fault]) -> None:
        super().__init__(f"{len(faults)} faults")
        self.faults = faults


@dataclass(frozen=True)
class Convert:
    """Turns what the user wrote into what the annotation says, or raises Problem.

    json: the type of what may be written, for the JSON Schema; None for the annotation itself.
    """

    function: Callable[[Any], Any]
    json: Any = None


@dataclass(eq=False)
class FieldInfo:
    """A key: its default, what it means, examples, and bounds on its value or its length."""

    default: Any = MISSING
    description: str = ""
    examples: tuple[Any, ...] = ()
    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None
    min_length: int | None = None
    max_length: int | None = None
    name: str = ""
    owner: type[Section] | None = None

    @property
    def hint(self) -> Any:
        """The annotation as written."""
        assert self.owner is not None
        return self.owner.model_checks.hints[self.name]

    @property
    def annotation(self) -> Any:
        """The annotation without what `Annotated` adds to it."""
        hint = self.hint
        return typing.get_args(hint)[0] if typing.get_origin(hint) is typing.Annotated else hint

    def excess(self, value: Any) -> str:
        """The bound that a value breaks, '' if it keeps to all."""
        if self.gt is not None and not value > self.gt:
            return f"must be > {self.gt:g}"
        if self.ge is not None and not value >= self.ge:
            return f"must be >= {self.ge:g}"
        if self.lt is not None and not value < self.lt:
            return f"must be < {self.lt:g}"
        if self.le is not None and not value <= self.le:
            return f"must be <= {self.le:g}"
        what = "characters" if isinstance(value, str) else "entries"
        if self.min_length is not None and len(value) < self.min_length:
            return f"number of {what} >= {self.min_length}"
        if self.max_length is not None and len(value) > self.max_length:
            return f"number of {what} <= {self.max_length}"
        return ""


def Field(
    *, default: Any = MISSING, description: str = "", examples: Collection[Any] = (), **bounds: Any
) -> Any:
    """A key of a section, or bounds within `Annotated`: gt, ge, lt, le, min_length, max_length."""
    return FieldInfo(default, description, tuple(examples), **bounds)


_Check = Callable[[Any, Key, list[Fault]], Any]


class Section:
    """One section of the case: immutable, without unknown keys, every key described.

    A subclass may define `_prepare`, which sees the data before they are read, and `_check`, which
    sees the section whose keys are all right by themselves; both raise Problem.
    """

    model_fields: ClassVar[dict[str, FieldInfo]] = {}
    model_checks: ClassVar[_Checks]
    # Whether keys that are not declared are kept, in `model_extra`, rather than refused.
    model_open: ClassVar[bool] = False
    model_extra: Mapping[str, Any]
    model_fields_set: frozenset[str]

    def __init_subclass__(cls) -> None:
        """Collect the keys, those of the parent first."""
        cls.model_fields, cls.model_checks = dict(cls.model_fields), _Checks(cls)
        for name in vars(cls).get("__annotations__", {}):
            field = vars(cls).get(name)
            if isinstance(field, FieldInfo):
                field.name, field.owner = name, cls
                cls.model_fields[name] = field
                delattr(cls, name)

    def __init__(self, **values: Any) -> None:
        """The section with these values, not checked, and defaults for the rest."""
        self._fill(values, {})

    def _fill(self, values: Mapping[str, Any], extra: Mapping[str, Any]) -> None:
        defaults = {name: field.default for name, field in self.model_fields.items()}
        self.__dict__.update(defaults | dict(values))
        self.__dict__["model_extra"] = dict(extra)
        self.__dict__["model_fields_set"] = frozenset(values)

    @classmethod
    def model_validate(cls, data: Any) -> Self:
        """The section that plain data describe; raises Invalid with every fault."""
        faults: list[Fault] = []
        section = cls._read(data, (), faults)
        if faults or section is None:
            raise Invalid(faults)
        return section

    @classmethod
    def _read(cls, data: Any, key: Key, faults: list[Fault]) -> Self | None:
        try:
            data = cls._prepare(data)
        except Problem as problem:
            faults.append(_told(problem, key, data))
            return None
        if not isinstance(data, dict):
            faults.append(Fault("section", key, data))
            return None
        known = len(faults)
        values, extra = {}, {}
        for name, field in cls.model_fields.items():
            if name in data:
                values[name] = cls.model_checks[name](data[name], (*key, name), faults)
            elif field.default is MISSING:
                faults.append(Fault("missing", (*key, name)))
        for name, value in data.items():
            if name in cls.model_fields:
                continue
            if cls.model_open:
                extra[name] = value
            else:
                faults.append(Fault("unknown", (*key, name), value))
        if len(faults) > known:
            return None
        section = cls()
        section._fill(values, extra)
        try:
            section._check()
        except Problem as problem:
            faults.append(_told(problem, key, data))
        return section

    @classmethod
    def _prepare(cls, data: Any) -> Any:
        return data

    def _check(self) -> None:
        """Nothing to agree on."""

    def model_dump(self, exclude: Collection[str] = ()) -> dict[str, Any]:
        """Every key with its value, defaults included, as plain data."""
        names = [name for name in self.model_fields if name not in exclude]
        return {name: _plain(getattr(self, name)) for name in names} | {
            name: _plain(value) for name, value in self.model_extra.items()
        }

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{type(self).__name__} is immutable")

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        return all(
            getattr(self, name) == getattr(other, name)
            for name in (*self.model_fields, "model_extra")
        )

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={getattr(self, name)!r}" for name in self.model_fields)
        return f"{type(self).__name__}({values})"


def section_of(annotation: Any) -> type[Section] | None:
    """The section class in a field's annotation, looking through `| None`."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return annotation
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        found = (section_of(option) for option in typing.get_args(annotation))
        return next((model for model in found if model is not None), None)
    return None


def _plain(value: Any) -> Any:
    if isinstance(value, Section):
        return value.model_dump()
    if isinstance(value, (tuple, list)):
        return [_plain(entry) for entry in value]
    if isinstance(value, dict):
        return {name: _plain(entry) for name, entry in value.items()}
    return value


# -- checks made from annotations, when they are first needed -------------------------------


class _Checks(dict[str, _Check]):
    """The checks of a section's keys, each made when its key is first met."""

    def __init__(self, section: type[Section]) -> None:
        super().__init__()
        self._section = section

    @cached_property
    def hints(self) -> dict[str, Any]:
        """The annotations of the section's keys."""
        return typing.get_type_hints(self._section, include_extras=True)

    def __missing__(self, name: str) -> _Check:
        self[name] = _check_of(self.hints[name])
        return self[name]


def _told(problem: Problem, key: Key, value: Any) -> Fault:
    return Fault("value", (*key, *problem.key), value, problem.wrong, problem.right)


def _check_of(hint: Any) -> _Check:
    """The function that reads a value as the annotation says."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return lambda value, key, faults: value
    if origin is typing.Annotated:
        return _annotated(arguments[0], arguments[1:])
    if origin in (typing.Union, types.UnionType):
        return _union(arguments)
    if origin is Literal:
        return _literal(arguments)
    if origin is tuple:
        return _tuple(arguments)
    if origin is dict:
        return _dict(arguments[1])
    if isinstance(hint, type) and issubclass(hint, Section):
        return hint._read
    return _scalar(hint)


def _annotated(hint: Any, marks: tuple[Any, ...]) -> _Check:
    inner = _check_of(hint)
    conversions = [mark.function for mark in marks if isinstance(mark, Convert)]
    bounds = [mark for mark in marks if isinstance(mark, FieldInfo)]

    def check(value: Any, key: Key, faults: list[Fault]) -> Any:
        known = len(faults)
        try:
            for convert in conversions:
                value = convert(value)
        except Problem as problem:
            faults.append(_told(problem, key, value))
            return None
        value = inner(value, key, faults)
        if len(faults) == known:
            for bound in bounds:
                excess = bound.excess(value)
                if excess:
                    faults.append(Fault("value", key, value, right=excess))
                    break
        return value

    return check


def _union(options: tuple[Any, ...]) -> _Check:
    """None where it is allowed, or the first option that has no fault to find."""
    optional = type(None) in options
    checks = [_check_of(option) for option in options if option is not type(None)]

    def check(value: Any, key: Key, faults: list[Fault]) -> Any:
        if optional and value is None:
            return None
        first: list[Fault] = []
        for option in checks:
            found: list[Fault] = []
            read = option(value, key, found)
            if not found:
                return read
            first = first or found
        faults.extend(first)
        return None

    return check


def _literal(words: tuple[str, ...]) -> _Check:
    def check(value: Any, key: Key, faults: list[Fault]) -> Any:
        if not isinstance(value, str) or value not in words:
            faults.append(Fault("choice", key, value, choices=words))
        return value

    return check


def _tuple(options: tuple[Any, ...]) -> _Check:
    """Entries of one type, or as many as there are types."""
    repeated = options[-1] is Ellipsis
    checks = [_check_of(option) for option in (options[:1] if repeated else options)]

    def check(value: Any, key: Key, faults: list[Fault]) -> Any:
        if not isinstance(value, (list, tuple)):
            faults.append(Fault("list", key, value))
            return None
        if not repeated and len(value) != len(checks):
            faults.append(Fault("list", key, value, right=f"{len(checks)} entries are expected"))
            return None
        return tuple(
            checks[0 if repeated else index](entry, (*key, index), faults)
            for index, entry in enumerate(value)
        )

    return check


def _dict(option: Any) -> _Check:
    entry_check = _check_of(option)

    def check(value: Any, key: Key, faults: list[Fault]) -> Any:
        if not isinstance(value, dict):
            faults.append(Fault("section", key, value))
            return None
        return {name: entry_check(entry, (*key, name), faults) for name, entry in value.items()}

    return check


_EXPECTED = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


def _scalar(kind: type) -> _Check:
    accepted = (int, float) if kind is float else (kind,)

    def check(value: Any, key: Key, faults: list[Fault]) -> Any:
        truth = isinstance(value, bool) and kind is not bool
        if truth or not isinstance(value, accepted):
            faults.append(Fault("value", key, value, right=f"{_EXPECTED[kind]} is expected"))
            return None
        return kind(value)

    return check
