"""Arithmetic that users write as text: numbers, pi, and functions of the time t."""

import ast
import math
import operator
import re
import warnings
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
# Of the numbers that users write: sixth powers of it are numbers, too.
LARGEST = 1e50
CONSTANTS = {name: lambda t: math.pi for name in ("pi", "π")}
_IN_TIME = CONSTANTS | {"t": lambda t: t}


def _checked(node: ast.AST, names: Mapping[str, Any]) -> ast.expr:
    """A node of an expression as one to be compiled; raises ValueError for no arithmetic."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        return ast.Constant(float(node.value))  # type: ignore[arg-type]
    if isinstance(node, ast.Name) and node.id in names:
        time = ast.Name("t", ast.Load())
        return time if node.id == "t" else _call(node.id, [time])
    if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
        return ast.UnaryOp(node.op, _checked(node.operand, names))
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        left, right = _checked(node.left, names), _checked(node.right, names)
        power = isinstance(node.op, ast.Pow)
        return _call("pow", [left, right]) if power else ast.BinOp(left, node.op, right)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        called = node.func.id
        if called in FUNCTIONS and node.args and not node.keywords:
            return _call(called, [_checked(part, names) for part in node.args])
    raise ValueError(f"{ast.unparse(node)[:40]} is not known in arithmetic")


def _call(name: str, parts: list[ast.expr]) -> ast.Call:
    return ast.Call(ast.Name(name, ast.Load()), parts, [])


def expression_in_time(text: str, names: Mapping[str, Any] = _IN_TIME) -> Callable[[float], float]:
    """The function that an expression such as '2*sin(pi*t)' stands for; raises ValueError.

    Powers are written ** or ^. names: functions of t by their names. What is checked to be
    arithmetic is compiled by Python.
    """
    if len(text) > 400:
        raise ValueError("it is too long")
    try:
        with warnings.catch_warnings():  # Python's remarks on what is refused below
            warnings.simplefilter("ignore")
            power = text.strip().replace("^", "**")
            body = _checked(ast.parse(power, mode="eval").body, names)
        function = ast.parse("lambda t: 0", mode="eval")
        function.body.body = body  # type: ignore[attr-defined]
        code = compile(ast.fix_missing_locations(function), "expression", "eval")
        known = {"__builtins__": {}, "pow": math.pow, **FUNCTIONS, **names}
        found: Callable[[float], float] = eval(code, known)
    except (SyntaxError, ArithmeticError, RecursionError, MemoryError) as error:
        wrong = f"it is not an expression ({getattr(error, 'msg', error)})"
        if re.match(r"\s*[-+.\d]\S*\s+[A-Za-zµ1]", text):
            wrong += "; numbers with units need the section `units` (`help units`)"
        raise ValueError(wrong) from None
    return found
