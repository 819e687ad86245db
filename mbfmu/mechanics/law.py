"""Functions that users write in Python, or as an expression, as kernels.

A law is compiled where it is used and not stored on disk, because the meaning of a closure may change. A law may
have kinks and absolute values, so it is differentiated by differences and not by complex steps.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any

import numpy as np
from numba import types
from numba.core.errors import NumbaError
from numba.extending import overload

from mbfmu.util.errors import UserError
from solvers.compiled.fingerprint import fingerprint_of_function
from solvers.compiled.kernel import COMPILED, has_raise, is_kernel, jit_uncached

FUNCTIONS: dict[str, Any] = {
    name: getattr(np, name)
    for name in ("sin cos tan arcsin arccos arctan arctan2 sinh cosh tanh exp log log10 sqrt sign".split())
} | {"abs": abs, "min": min, "max": max, "pi": np.pi, "e": np.e}
LAW_DIFFERENCE_STEP, MIN_DIFFERENCE_STEP = 1e-3, 1e-6  # of differences: of the argument, and of one that is nearly zero
# Steps of differences for derivatives, relative to the width over which a law changes
LAW_FIRST_STEP_RATIO, SECOND_STEP_RATIO, THIRD_STEP_RATIO = 1e-3, 3e-3, 1e-2
N_CHECK_POINTS, DERIVATIVE_TOLERANCE = 64, 1e-6  # points at which differences over two steps must agree so well


def arguments_of(what: str, law: Any) -> int:
    """Return how many arguments a function takes."""
    try:
        return len(inspect.signature(law.py_func if is_kernel(law) else law).parameters)
    except (TypeError, ValueError) as error:
        raise UserError(f"{what} is {law!r}, whose arguments cannot be determined: {error}") from error


def from_text(what: str, text: str, names: tuple[str, ...]) -> Callable[..., Any]:
    """Return the function that an expression is, of variables with these names; UserError for any other text."""
    allowed = (*names, *FUNCTIONS)
    try:
        tree = ast.parse(text, mode="eval")
    except (SyntaxError, ValueError, RecursionError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else error
        raise UserError(f"{what} is {text[:200]!r}, which is not an expression: {reason}") from error
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id not in allowed:
            raise UserError(f"{what} is {text!r}, where {node.id!r} is not known; allowed: {', '.join(allowed)}")
        if isinstance(node, _NO_ARITHMETIC):
            raise UserError(f"{what} is {text!r}, which contains ^, <<, >>, @ or ~; a power is written x**2")
        if not isinstance(node, _ALLOWED) or (isinstance(node, ast.Call) and not isinstance(node.func, ast.Name)):
            raise UserError(f"{what} is {text!r}; allowed: numbers, {', '.join(names)} and functions of them")
    return _evaluate(f"lambda {', '.join(names)}: {text}")


@cache
def _evaluate(source: str) -> Callable[..., Any]:
    """Return the function of a source that was checked: the same one each time, so that it is compiled once."""
    found: Callable[..., Any] = eval(compile(source, "<expression>", "eval"), dict(FUNCTIONS))
    return found


_ALLOWED = (
    ast.Expression, ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Load, ast.Constant, ast.IfExp, ast.Compare,
    ast.BoolOp, ast.operator, ast.unaryop, ast.cmpop, ast.boolop,
)  # fmt: skip
_NO_ARITHMETIC = ast.BitXor, ast.LShift, ast.RShift, ast.MatMult, ast.Invert  # operators without a real result


def names_in(text: str) -> set[str]:
    """Return the names in an expression; none where it is no expression."""
    try:
        return {node.id for node in ast.walk(ast.parse(text, mode="eval")) if isinstance(node, ast.Name)}
    except (SyntaxError, ValueError, RecursionError):
        return set()


def check_names(what: str, text: str, known: tuple[str, ...]) -> None:
    """Raise UserError if an expression contains names that are not known, or names with dots; the message contains the
    expression as it is written with ``uses``.
    """
    try:
        tree = ast.parse(text, mode="eval")
    except (SyntaxError, ValueError, RecursionError):
        return  # from_text reports it
    allowed = (*known, *FUNCTIONS)
    dotted = [ast.unparse(node) for node in ast.walk(tree) if isinstance(node, ast.Attribute)]
    unknown = sorted(names_in(text) - set(allowed))
    if not dotted and not unknown:
        return
    rewritten = WithoutDots()
    new = ast.unparse(rewritten.visit(tree))
    others = [name for name in sorted(names_in(new) - set(allowed)) if name not in rewritten.sources]
    given = [*(f"{name!r}: {source}" for name, source in rewritten.sources.items()), *(f"{n!r}: ..." for n in others)]
    if dotted:
        reason = f"which contains {max(dotted, key=len)!r}; names in expressions have no dots"
    else:
        reason = f"where {unknown[0]!r} is not known; allowed: {', '.join(allowed)}"
    raise UserError(
        f'{what} is {text!r}, {reason}. Give other quantities with `uses`: "{new}", uses={{{", ".join(given)}}}'
    )


class WithoutDots(ast.NodeTransformer):
    """Replaces ``crank.angle`` and ``crank.angle()`` in an expression by ``crank_angle``.

    Attributes
    ----------
    sources
        What the new names stand for, in Python.
    """

    def __init__(self) -> None:
        self.sources: dict[str, str] = {}

    def visit_Call(self, node: ast.Call) -> ast.AST:
        """Replace the call of a method."""
        return self._named(node, node.func) if isinstance(node.func, ast.Attribute) else self.generic_visit(node)

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        """Replace an attribute."""
        return self._named(node, node)

    def _named(self, node: ast.expr, attribute: ast.Attribute) -> ast.Name:
        name = "_".join(re.findall(r"[A-Za-z0-9_]+", ast.unparse(attribute)))
        source = ast.unparse(node)
        self.sources[name] = source if isinstance(node, ast.Call) else f"{source}()"
        return ast.Name(name, ast.Load())


def law_of(what: str, given: Any, names: tuple[str, ...]) -> Any:
    """Return a kernel ``law(*names)`` of a function or an expression.

    Raises
    ------
    UserError
        It has other arguments, or cannot be compiled; the message gives the reason.
    """
    law = from_text(what, given, names) if isinstance(given, str) else given
    count = arguments_of(what, law)
    if count != len(names):
        raise UserError(f"{what} takes {count} arguments; allowed: {len(names)} ({', '.join(names)})")
    if has_raise(law):
        raise UserError(
            f"{what} raises an exception, which compiled code cannot handle; return nan instead, which ends the run"
        )
    try:
        return compiled(law, count)
    except NumbaError as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip() and "nopython" not in line]
        raise UserError(
            f"{what} cannot be compiled: {lines[0][:200]}; it must be arithmetic of its arguments and of numbers that "
            "do not change, with functions of math or NumPy"
        ) from error


_kernels: dict[tuple[str, int], Any] = {}  # by fingerprint and number of arguments


@cache
def compiled(law: Any, count: int) -> Any:
    """Return a function of real numbers as a kernel.

    Equal functions are one kernel: a model creates its functions again whenever it is built.
    """
    made = law if is_kernel(law) or not COMPILED else jit_uncached(_as_local(law))
    made = _kernels.setdefault((fingerprint_of_function(law), count), made)
    if COMPILED:
        made.compile(types.float64(*[types.float64] * count))
    return made


def _as_local(law: Any) -> Any:
    """Return a function under a qualified name of a local one: kernels of other names are known by them, and functions
    of one name, such as lambdas, would be mistaken for each other (:mod:`solvers.compiled.symbols`).
    """
    if not isinstance(law, FunctionType):
        return law
    own = FunctionType(law.__code__, law.__globals__, law.__name__, law.__defaults__, law.__closure__)
    own.__kwdefaults__, own.__qualname__ = law.__kwdefaults__, f"{_as_local.__name__}.<locals>.{law.__name__}"
    return own


def at(law: Any, t: float, x: Any, rate: Any) -> Any:
    """law(t, x, rate) in a kernel; where x and rate are complex, with the derivatives by their imaginary parts."""
    return _complex_step(law, t, x, rate) if isinstance(x, complex) else law(t, x, rate)


@overload(at, strict=False)
def _at(law: Any, t: Any, x: Any, rate: Any) -> Any:
    if isinstance(x, types.Complex):
        return _complex_step
    return lambda law, t, x, rate: law(t, x, rate)


def _complex_step(law: Any, t: float, x: Any, rate: Any) -> Any:
    a, b = x.real, rate.real
    least = MIN_DIFFERENCE_STEP / LAW_DIFFERENCE_STEP
    h, k = LAW_DIFFERENCE_STEP * max(abs(a), least), LAW_DIFFERENCE_STEP * max(abs(b), least)
    by_x = law(t, a - 2.0 * h, b) - 8.0 * law(t, a - h, b) + 8.0 * law(t, a + h, b) - law(t, a + 2.0 * h, b)
    by_rate = law(t, a, b - 2.0 * k) - 8.0 * law(t, a, b - k) + 8.0 * law(t, a, b + k) - law(t, a, b + 2.0 * k)
    return law(t, a, b) + 1j * (by_x / (12.0 * h) * x.imag + by_rate / (12.0 * k) * rate.imag)


def real_derivatives(law: Any, x: float, width: float) -> Any:
    """law(x) and its first two derivatives, by differences of sixth order."""
    value, h, k = law(x), LAW_FIRST_STEP_RATIO * width, SECOND_STEP_RATIO * width
    rate = 45.0 * (law(x + h) - law(x - h)) - 9.0 * (law(x + 2.0 * h) - law(x - 2.0 * h))
    rate += law(x + 3.0 * h) - law(x - 3.0 * h)
    second = 270.0 * (law(x + k) + law(x - k)) - 27.0 * (law(x + 2.0 * k) + law(x - 2.0 * k))
    second += 2.0 * (law(x + 3.0 * k) + law(x - 3.0 * k)) - 490.0 * value
    return value, rate / (60.0 * h), second / (180.0 * k * k)


def complex_derivatives(law: Any, x: complex, width: float) -> Any:
    """... where x is complex, with their derivatives by its imaginary part."""
    a, b, h = x.real, 1j * x.imag, THIRD_STEP_RATIO * width
    value, rate, second = derivatives(law, a, width)
    third = 338.0 * (law(a + 2.0 * h) - law(a - 2.0 * h)) - 488.0 * (law(a + h) - law(a - h))
    third += 7.0 * (law(a + 4.0 * h) - law(a - 4.0 * h)) - 72.0 * (law(a + 3.0 * h) - law(a - 3.0 * h))
    return value + rate * b, rate + second * b, second + third / (240.0 * h * h * h) * b


def derivatives(law: Any, x: Any, width: float) -> Any:
    """law(x) and its first two derivatives in a kernel; ``width``: change of x over which it changes noticeably."""
    return (complex_derivatives if isinstance(x, complex) else real_derivatives)(law, x, width)


@overload(derivatives, strict=False)
def _derivatives(law: Any, x: Any, width: Any) -> Any:
    if isinstance(x, types.Complex):
        return complex_derivatives
    return real_derivatives


def resolved(law: Any, ends: Any, width: float) -> bool:
    """Whether the second derivative of a law is the same over a smaller step, at random points between two ends."""
    found = []
    for x in np.random.default_rng(0).uniform(ends[0], ends[1], N_CHECK_POINTS):
        (value, _, second), (_, _, finer) = (real_derivatives(law, x, part * width) for part in (1.0, 0.25))
        found.append((abs(second - finer), abs(finer), abs(value)))
    off, second, size = np.max(found, axis=0)
    return bool(not off > DERIVATIVE_TOLERANCE * (second + 1e-2 * size / width**2))  # the last is what rounding leaves
