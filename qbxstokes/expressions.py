"""Arithmetic that users write as text: numbers, pi, and functions of the time t."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

FUNCTIONS: dict[str, Callable[..., float]] = {
    name: getattr(math, name)
    for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh", "sinh", "cosh", "atan", "erf")
} | {"abs": abs, "min": min, "max": max}
_OPERATORS: dict[type, Callable[..., float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: math.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
CONSTANTS = {name: lambda t: math.pi for name in ("pi", "π")}
_IN_TIME = CONSTANTS | {"t": lambda t: t}


def _compiled(node: ast.AST, names: Mapping[str, Any]) -> Callable[[float], float]:
    """What a node of an expression says, as a function of t; raises ValueError."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        number = float(node.value)  # type: ignore[arg-type]
        return lambda t: number
    if isinstance(node, ast.Name) and node.id in names:
        named: Callable[[float], float] = names[node.id]
        return named
    act, parts = None, []
    if isinstance(node, ast.UnaryOp):
        act, parts = _OPERATORS.get(type(node.op)), [node.operand]
    elif isinstance(node, ast.BinOp):
        act, parts = _OPERATORS.get(type(node.op)), [node.left, node.right]
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        act, parts = FUNCTIONS.get(node.func.id), node.args
    if act is None or not parts:
        what = node.id if isinstance(node, ast.Name) else type(node).__name__.lower()
        raise ValueError(f"{what} is not known in arithmetic")
    inputs = [_compiled(part, names) for part in parts]
    if len(inputs) == 2:
        left, right = inputs
        return lambda t: act(left(t), right(t))
    return lambda t: act(*(value(t) for value in inputs))


def expression_in_time(text: str, names: Mapping[str, Any] = _IN_TIME) -> Callable[[float], float]:
    """The function that an expression such as '2*sin(pi*t)' stands for; raises ValueError."""
    if len(text) > 400:
        raise ValueError("it is too long")
    try:
        return _compiled(ast.parse(text.strip(), mode="eval").body, names)
    except (SyntaxError, ArithmeticError, RecursionError, MemoryError) as error:
        raise ValueError(f"it is not an expression ({getattr(error, 'msg', error)})") from None
