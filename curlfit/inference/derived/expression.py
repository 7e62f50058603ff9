"""Arithmetic of named numbers as text, in a small subset of Python's grammar."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.stone import GRAVITY

_LONGEST = 400  # characters
_LARGEST = 1e300  # number in an expression, close to what a float can hold
_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_STEP = 1e-30  # imaginary, for derivatives
_OPERATORS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: lambda base, exponent: np.power(base, _real_if_constant(exponent)),
}


def _real_if_constant(value: Any) -> Any:
    """The value as real if possible: NumPy multiplies out only integer powers
    of real type."""
    is_real = np.isrealobj(value) or not np.any(np.imag(value))
    return np.real(value) if is_real else value


def _choice(is_first: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """The first or the second of two numbers, by their real parts."""
    return lambda a, b: np.where(is_first(np.real(a), np.real(b)), a, b)


# All differentiable by a complex step, hence no conjugates.
_FUNCTIONS: dict[str, tuple[int, Callable[..., Any]]] = {
    "sqrt": (1, np.sqrt),
    "exp": (1, np.exp),
    "log": (1, np.log),
    "log10": (1, np.log10),
    "sin": (1, np.sin),
    "cos": (1, np.cos),
    "tan": (1, np.tan),
    "atan": (1, np.arctan),
    "abs": (1, lambda a: np.where(np.real(a) < 0, -a, a)),
    "hypot": (2, lambda a, b: np.sqrt(a * a + b * b)),
    "min": (2, _choice(np.less)),
    "max": (2, _choice(np.greater)),
}


@dataclass(frozen=True)
class Expression:
    """Arithmetic of named numbers.

    Attributes
    ----------
    text : as given.
    names : of the numbers in it, in their order.
    """

    text: str
    names: tuple[str, ...]
    _function: Callable[[Mapping[str, Any]], Any]

    def of(self, values: Mapping[str, Any]) -> Any:
        """The value, a float or an array; NaN or infinite where it is undefined."""
        with np.errstate(all="ignore"):
            return self._function(values)

    def gradient(self, values: Mapping[str, float]) -> dict[str, float]:
        """Derivative by each name, exact to rounding.

        By a complex step (Squire and Trapp 1998, SIAM Review 40): f(x + ih) =
        f(x) + ih f'(x).
        """
        slopes = {}
        for name in self.names:
            moved = {key: complex(value) for key, value in values.items()}
            moved[name] += _STEP * 1j
            with np.errstate(over="ignore"):  # an infinite slope tells
                slopes[name] = float(np.imag(self.of(moved)) / _STEP)
        return slopes


def parse(
    text: str, names: Sequence[str], sums: Mapping[str, Mapping[str, float]]
) -> Expression:
    """An expression from text.

    Parameters
    ----------
    names : that may occur.
    sums : weights of sums by their expression, in which they are rounded; such a sum
        may occur as written there, in parentheses or alone.

    Raises
    ------
    InputError : it is not arithmetic, or contains other names.
    """
    text = " ".join(str(text).split())
    label = f"derive {quoted(text)}"
    if not text:
        raise InputError(
            "derive: the expression is empty; expected arithmetic of parameters"
        )
    if len(text) > _LONGEST:
        raise InputError(f"derive: {len(text)} characters; expected at most {_LONGEST}")
    try:
        tree = ast.parse(_multiplied_out(text, sums), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        raise InputError(
            f"{label}: not an arithmetic expression; expected one such as "
            f"'{names[0]} / {names[min(1, len(names) - 1)]}', "
            "with + - * / ** and parentheses"
        ) from None
    used: dict[str, None] = {}  # a set in order
    function = _function_of(tree, label, names, used)
    if not used:
        raise InputError(
            f"{label}: it contains no parameter; the parameters are {', '.join(names)}"
        )
    return Expression(text, tuple(used), function)


def _multiplied_out(text: str, sums: Mapping[str, Mapping[str, float]]) -> str:
    """The text with products as Python writes them: "0.977 mu2_eta" is
    "0.977 * mu2_eta"."""
    for written, weights in sums.items():
        product = " + ".join(
            f"({weight!r}) * {name}" for name, weight in weights.items()
        )
        if text == written:
            return product
        text = re.sub(rf"(?<!\w)\( *{re.escape(written)} *\)", f"({product})", text)
    return re.sub(rf"(?<![\w.])({_NUMBER}) +(?=[A-Za-z_])", r"\1 * ", text)


def _function_of(
    node: ast.AST, label: str, names: Sequence[str], used: dict[str, None]
) -> Callable[[Mapping[str, Any]], Any]:
    """The value of a node as a function of the values of the names in it, which are
    collected in `used`.

    Raises `InputError`, whose message begins with `label`, for anything that is not
    arithmetic.
    """

    def function_of(part: ast.AST) -> Callable[[Mapping[str, Any]], Any]:
        return _function_of(part, label, names, used)

    if isinstance(node, ast.Constant):
        if isinstance(node.value, bool) or not isinstance(node.value, int | float):
            raise InputError(f"{label}: {quoted(node.value)} is not a number")
        if not abs(node.value) < _LARGEST:
            raise InputError(f"{label}: a number is too large")
        number = np.float64(node.value)
        return lambda _: number
    if isinstance(node, ast.Name):
        name = node.id
        if name not in names:
            raise InputError(
                f"{label}: no parameter {quoted(name)}; the parameters are "
                f"{', '.join(names)}"
            )
        used.setdefault(name)
        return lambda values: np.asarray(values[name])[()]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.UAdd | ast.USub):
        operand = function_of(node.operand)
        sign = -1.0 if isinstance(node.op, ast.USub) else 1.0
        return lambda values: sign * operand(values)
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        left = function_of(node.left)
        right = function_of(node.right)
        operator = _OPERATORS[type(node.op)]
        return lambda values: operator(left(values), right(values))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        function = _function_called(node, node.func.id, label)
        arguments = [function_of(argument) for argument in node.args]
        return lambda values: function(*(argument(values) for argument in arguments))
    raise InputError(
        f"{label}: only numbers, names, + - * / ** and the functions "
        f"{', '.join(_FUNCTIONS)} may occur"
    )


def _function_called(node: ast.Call, name: str, label: str) -> Callable[..., Any]:
    """The function of a call, which has as many arguments as it takes."""
    if name not in _FUNCTIONS:
        raise InputError(
            f"{label}: no function {quoted(name)}; the functions are "
            f"{', '.join(_FUNCTIONS)}"
        )
    count, function = _FUNCTIONS[name]
    if len(node.args) != count or node.keywords:
        raise InputError(
            f"{label}: {name} takes {count} argument{'s' if count > 1 else ''}"
        )
    return function


CONSTANTS = {"g": GRAVITY, "pi": math.pi}
"""Constants that an expression may contain unless a parameter has the same
name; g in m/s^2."""
