"""What the sections of a case share: numbers, angles, vectors and texts as users write them."""

from __future__ import annotations

import ast
import math
import operator
import re
from typing import Annotated, Any

from qbxstokes.case.model import Convert, Problem

_OPERATORS: dict[type, Any] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_NAMES = {"pi": math.pi, "π": math.pi}
_ANGLE = re.compile(r"(?P<number>.*?)\s*(?P<unit>deg|degrees?|°|rad|radians?)\Z", re.DOTALL)


def _evaluate(node: ast.AST) -> float:
    if isinstance(node, ast.Expression):
        return _evaluate(node.body)
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        return float(node.value)  # type: ignore[arg-type]
    if isinstance(node, ast.Name) and node.id in _NAMES:
        return _NAMES[node.id]
    if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
        return float(_OPERATORS[type(node.op)](_evaluate(node.operand)))
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        value = _OPERATORS[type(node.op)](_evaluate(node.left), _evaluate(node.right))
        return float(value)
    raise ValueError("not arithmetic")


def expression(text: str) -> float:
    """Value of simple arithmetic such as 'pi/2' or '1/50'; raises ValueError."""
    if len(text) > 80:
        raise ValueError("too long")
    try:
        return _evaluate(ast.parse(text.strip(), mode="eval"))
    except (SyntaxError, TypeError, ArithmeticError, RecursionError, MemoryError) as error:
        raise ValueError(str(error)) from None


def to_number(value: Any) -> float:
    """A finite real number, given as a number or as simple arithmetic in a string."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise Problem(f"is {describe(value)}", "a number is expected, such as 0.5 or 1e-6")
    try:
        number = expression(value) if isinstance(value, str) else float(value)
    except (ValueError, OverflowError):
        right = "write one, such as 0.5, 1e-6 or pi/2"
        if isinstance(value, str) and re.fullmatch(r"[-+]?[0-9]+,[0-9]+", value.strip()):
            right = f"write a point for the comma: {value.strip().replace(',', '.')}"
        elif isinstance(value, str) and re.fullmatch(r"[-+.0-9eE]+ *[A-Za-z/^0-9]+", value.strip()):
            right += ", without a unit: lengths are in c, times in tau"
        raise Problem(f"{describe(value)} is not a number", right) from None
    if not math.isfinite(number):
        raise Problem(f"{describe(value)} is not finite", "a finite number is expected")
    return number


def to_angle(value: Any) -> float:
    """An angle in radians: a number, or a string such as '90 deg' or 'pi/2'."""
    if isinstance(value, str):
        match = _ANGLE.match(value.strip())
        number = match["number"] if match else value
        degrees = match is not None and match["unit"] in ("deg", "degree", "degrees", "°")
        try:
            angle = expression(number)
        except ValueError:
            raise Problem(
                f"{describe(value)} is not an angle", "write radians, 'pi/2' or '90 deg'"
            ) from None
        return to_number(math.radians(angle) if degrees else angle)
    return to_number(value)


def to_integer(value: Any) -> int:
    """A whole number; 1e3 counts as one, 1.5 and true do not."""
    if isinstance(value, str):
        value = to_number(value)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise Problem(f"is {describe(value)}", "a whole number is expected")
    if not math.isfinite(value) or value != int(value):
        raise Problem(f"{describe(value)} is not a whole number", "a whole number is expected")
    return int(value)


def to_boolean(value: Any) -> bool:
    """true or false, and nothing that merely resembles them."""
    if not isinstance(value, bool):
        raise Problem(f"is {describe(value)}", "write true or false")
    return value


def to_text(value: Any) -> str:
    """A printable string; a bare number is taken as its text."""
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        raise Problem(f"is {describe(value)}", "a text is expected")
    text = str(value)
    if not text.isprintable():
        raise Problem("holds control characters", "printable text on one line is expected")
    return text


def entries(count: int, example: str) -> Any:
    """Validator: a list of exactly `count` entries."""

    def check(value: Any) -> Any:
        if not isinstance(value, (list, tuple)):
            raise Problem(f"is {describe(value)}", f"{count} numbers are expected: {example}")
        if len(value) != count:
            raise Problem(f"has {len(value)} entries", f"{count} numbers are expected: {example}")
        return tuple(value)

    return check


def describe(value: Any) -> str:
    """What the user wrote, in a few words."""
    if value is None:
        return "empty"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return repr(value if len(value) <= 40 else value[:37] + "...")
    if isinstance(value, dict):
        return "a mapping of keys"
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)} entries"
    return f"{value:.6g}" if isinstance(value, float) else str(value)[:40]


Number = Annotated[float, Convert(to_number, json=float | str)]
Angle = Annotated[float, Convert(to_angle, json=float | str)]
Integer = Annotated[int, Convert(to_integer)]
Boolean = Annotated[bool, Convert(to_boolean)]
Text = Annotated[str, Convert(to_text)]
Vector = Annotated[
    tuple[Number, Number, Number],
    Convert(entries(3, "[x1, x2, x3]"), json=list[float | str]),
]
Quadruple = Annotated[
    tuple[Number, Number, Number, Number],
    Convert(entries(4, "[q0, q1, q2, q3]"), json=list[float | str]),
]
