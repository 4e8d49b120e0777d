"""What users write: numbers, angles, expressions, words; and what is told where it is wrong."""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

from qbxstokes.errors import nearest
from qbxstokes.expressions import CONSTANTS, LARGEST, expression_in_time

Key = tuple[str | int, ...]
T = TypeVar("T")


class Problem(ValueError):
    """What is wrong, and what would be right (made when it is asked for, if a function).

    key: leads from the value at hand to the one at fault. unknown: whether a key is misspelt.
    faults: this one and those that were found with it.
    """

    def __init__(
        self, wrong: str, right: str | Callable[[], str] = "", key: Key = (), unknown: bool = False
    ) -> None:
        self.wrong, self._right, self.key, self.unknown = wrong, right, key, unknown
        self.faults = [self]

    @property
    def right(self) -> str:
        """What would be right."""
        return self._right if isinstance(self._right, str) else self._right()

    def __str__(self) -> str:
        return f"{self.wrong}; {self.right}"


@contextmanager
def at(*path: str | int) -> Iterator[None]:
    """Within it problems are those of the value at `path`."""
    try:
        yield
    except Problem as problem:
        for fault in problem.faults:
            fault.key = (*path, *fault.key)
        raise


def gathered(read: Callable[[Any], T], names: Iterable[str | int]) -> list[T]:
    """What `read` makes of each name; raises Problem with the faults of all of them."""
    values, faults = [], []
    for name in names:
        try:
            with at(name):
                values.append(read(name))
        except Problem as problem:
            faults += problem.faults
    if faults:
        faults[0].faults = faults
        raise faults[0]
    return values


def refuse(data: Any, keys: Mapping[Any, str], where: str) -> None:
    """Raise Problem where plain data give one of the keys, which have no meaning there.

    keys: with what would be right in the place of each.
    """
    for path, right in keys.items():
        held = data
        for part in path:
            held = held.get(part) if isinstance(held, dict) else None
        if held is not None:
            raise Problem(f"has no meaning {where}", right, path)


def describe(value: Any) -> str:
    """What the user wrote, in a few words."""
    if value is None:
        return "empty"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str) and value.startswith("<python>.py:"):  # see `flows.user.hand_over`
        return f"the function {value.partition(':')[2]}"
    if isinstance(value, str):
        return repr(value if len(value) <= 40 else value[:37] + "...")
    if isinstance(value, dict):
        return "a mapping of keys"
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)} entries"
    return f"{value:.6g}" if isinstance(value, float) else str(value)[:40]


def meant(word: str, known: Iterable[str], otherwise: str, more: str = "") -> Callable[[], str]:
    """Tells the known word that `word` most resembles, and more; or something otherwise."""
    return partial(nearest, word, known, otherwise, more)


# -- expressions ----------------------------------------------------------------------------------

_ANGLE = re.compile(r"(?P<number>.*?)\s*(?P<unit>deg|degrees?|°|rad|radians?)\Z", re.DOTALL)


def expression(text: str) -> float:
    """Value of arithmetic such as 'pi/2' or '1/50'; raises ValueError."""
    try:
        return float(expression_in_time(text, CONSTANTS)(0.0))
    except (ArithmeticError, TypeError) as error:
        raise ValueError(str(error)) from None


def to_number(value: Any) -> float:
    """A finite real number, given as a number or as simple arithmetic in a string."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        right = "a number is expected, such as 0.5 or 1e-6"
        if isinstance(value, dict | list):
            right = "one number is expected, such as 0.5; several values are an axis of `sweep`"
        raise Problem(f"is {describe(value)}", right)
    try:
        number = expression(value) if isinstance(value, str) else float(value)
    except (ValueError, OverflowError):
        right = "write one, such as 0.5, 1e-6 or pi/2"
        if isinstance(value, str) and re.fullmatch(r"[-+]?[0-9]+,[0-9]+", value.strip()):
            right = f"write a point for the comma: {value.strip().replace(',', '.')}"
        elif isinstance(value, str) and re.fullmatch(r"[-+.0-9eE]+ *[A-Za-z/^0-9]+", value.strip()):
            right += ", without a unit: lengths are in c, times in tau (`help units`)"
        raise Problem(f"{describe(value)} is not a number", right) from None
    if not math.isfinite(number):
        raise Problem(f"{describe(value)} is not finite", "a finite number is expected")
    if abs(number) > LARGEST:
        raise Problem(f"{describe(value)} is beyond {LARGEST:g}", "a smaller number, other units")
    return number


def or_infinite(value: Any) -> float:
    """A number, or inf."""
    return math.inf if value in ("inf", ".inf", math.inf) else to_number(value)


def to_angle(value: Any) -> float:
    """An angle in radians: a number, or a string such as '90 deg' or 'pi/2'."""
    if not isinstance(value, str):
        return to_number(value)
    match = _ANGLE.match(value.strip())
    try:
        angle = expression(match["number"] if match else value)
    except ValueError:
        right = "write radians, 'pi/2' or '90 deg'"
        raise Problem(f"{describe(value)} is not an angle", right) from None
    return to_number(math.radians(angle) if match and match["unit"][0] in "d°" else angle)


def to_integer(value: Any) -> int:
    """A whole number; 1e3 counts as one, 1.5 and true do not."""
    right = "a whole number is expected"
    value = to_number(value) if isinstance(value, str) else value
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise Problem(f"is {describe(value)}", right)
    if not math.isfinite(value) or value != int(value):
        raise Problem(f"{describe(value)} is not a whole number", right)
    return int(value)


def to_text(value: Any) -> str:
    """A printable string; a bare number is taken as its text."""
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        raise Problem(f"is {describe(value)}", "a text is expected")
    text = str(value)
    if not text.isprintable():
        raise Problem("holds control characters", "printable text on one line is expected")
    return text


def with_numbers(value: Any) -> Any:
    """Nested data with what texts say of numbers and angles; words stay as they are."""
    if isinstance(value, dict):
        return {name: with_numbers(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [with_numbers(entry) for entry in value]
    if value in ("inf", ".inf"):
        return math.inf  # tumbling, as an orbit constant
    try:
        return to_angle(value) if isinstance(value, str) else value
    except Problem:
        return value


def increasing(values: Iterable[float], *path: str | int) -> None:
    """Raise Problem where a value does not follow the one before it."""
    last = -math.inf
    for place, value in enumerate(values):
        if value <= last:
            wrong = f"{value:g} does not follow {last:g}"
            raise Problem(wrong, "numbers in increasing order", (*path, place))
        last = value
