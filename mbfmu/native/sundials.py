"""SUNDIALS IDA in the runtime of native FMUs: what it calls back, and declarations for C."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from solvers.compiled.ffi import array_at
from solvers.compiled.kernel import types
from solvers.steppers import eliminated_newton
from solvers.steppers.ida import eliminated_callbacks, tree_callbacks
from solvers.steppers.ida.calls import CALLBACKS, FUNCTION_NAMES, N_WORDS, OBJECTS, RESIDUAL
from solvers.steppers.ida.dense_callbacks import (
    apply_preconditioner_at,
    evaluate_jacobian_at,
    evaluate_residual_at,
    multiply_matrix,
    set_error_weights,
    set_up_preconditioner_at,
)

from .sundials_files import LIBRARIES

CONTEXT_FUNCTIONS = (  # that C calls by itself
    "SUNContext_Create", "SUNContext_SetLogger", "SUNContext_ClearErrHandlers", "SUNContext_PushErrHandler",
    "SUNContext_Free", "N_VGetArrayPointer", "SUNDenseMatrix_Data",
)  # fmt: skip
NO_CALLBACK = -1  # of a callback that a family does not have, so that IDA does not call it

residual_of_tree, set_up_tree = tree_callbacks.evaluate_residual, tree_callbacks.set_up_preconditioner
apply_to_tree, set_tree_weights = tree_callbacks.apply_preconditioner, tree_callbacks.set_error_weights
residual_of_loops, set_up_loops = eliminated_callbacks.evaluate_residual, eliminated_callbacks.set_up_preconditioner
apply_to_loops = eliminated_newton.apply_preconditioner


def residual(instance: Any, t: float, y: Any, slopes: Any, out: Any) -> int:
    """Evaluate the residual of IDA; vectors are given by the addresses of their entries, as below."""
    problem = instance.given
    n = problem.memory.ida.y.shape[0]
    evaluate_residual_at(t, array_at(y, n), array_at(slopes, n), array_at(out, n), problem)
    return 0


def set_up_preconditioner(instance: Any, t: float, y: Any, slopes: Any, cj: float) -> int:
    """Set up the preconditioner."""
    problem = instance.given
    n = problem.memory.ida.y.shape[0]
    set_up_preconditioner_at(t, array_at(y, n), array_at(slopes, n), problem)
    return 0


def apply_preconditioner(instance: Any, t: float, y: Any, slopes: Any, right: Any, left: Any, cj: float) -> int:
    """Apply the preconditioner to ``right``."""
    problem = instance.given
    n = problem.memory.ida.y.shape[0]
    apply_preconditioner_at(t, array_at(y, n), array_at(slopes, n), array_at(right, n), array_at(left, n), cj, problem)
    return 0


def matvec(instance: Any, x: Any, product: Any) -> int:
    """Multiply Newton's matrix by ``x``."""
    problem = instance.given
    n = problem.memory.ida.y.shape[0]
    multiply_matrix(array_at(x, n), array_at(product, n), problem)
    return 0


def jacobian(instance: Any, t: float, cj: float, y: Any, slopes: Any, matrix: Any) -> int:
    """Fill Newton's matrix."""
    problem = instance.given
    n = problem.memory.ida.y.shape[0]
    evaluate_jacobian_at(t, cj, array_at(y, n), array_at(slopes, n), array_at(matrix, n * n), problem)
    return 0


def error_weights(instance: Any, y: Any, out: Any) -> int:
    """Weigh the errors of the unknowns."""
    problem = instance.given
    n = problem.memory.ida.y.shape[0]
    set_error_weights(array_at(y, n), array_at(out, n), problem)
    return 0


def tree_residual(instance: Any, t: float, y: Any, slopes: Any, out: Any) -> int:
    """As those above, for large trees."""
    problem = instance.given
    n = problem.memory.ida.y.shape[0]
    residual_of_tree(t, array_at(y, n), array_at(slopes, n), array_at(out, n), problem)
    return 0


def set_up_tree_preconditioner(instance: Any, t: float, y: Any, slopes: Any, cj: float) -> int:
    """Set up the preconditioner; 1: it is singular there."""
    problem = instance.given
    n = problem.memory.ida.y.shape[0]
    code: int = set_up_tree(t, array_at(y, n), array_at(slopes, n), cj, problem)
    return code


def apply_tree_preconditioner(instance: Any, t: float, y: Any, slopes: Any, right: Any, left: Any, cj: float) -> int:
    """Apply the preconditioner to ``right``."""
    problem = instance.given
    n = problem.memory.ida.y.shape[0]
    apply_to_tree(array_at(y, n), array_at(right, n), array_at(left, n), problem)
    return 0


def no_matvec(instance: Any, x: Any, product: Any) -> int:
    """IDA takes differences of the residual."""
    return NO_CALLBACK


def no_jacobian(instance: Any, t: float, cj: float, y: Any, slopes: Any, matrix: Any) -> int:
    """Newton's matrix is not made."""
    return NO_CALLBACK


def tree_error_weights(instance: Any, y: Any, out: Any) -> int:
    """Weigh the errors of the unknowns."""
    problem = instance.given
    n = problem.memory.ida.y.shape[0]
    set_tree_weights(array_at(y, n), array_at(out, n), problem)
    return 0


def eliminated_residual(instance: Any, t: float, y: Any, slopes: Any, out: Any) -> int:
    """As those above, where constraints are eliminated."""
    problem = instance.given
    n = problem.memory.ida.y.shape[0]
    residual_of_loops(t, array_at(y, n), array_at(slopes, n), array_at(out, n), problem)
    return 0


def set_up_eliminated_preconditioner(instance: Any, t: float, y: Any, slopes: Any, cj: float) -> int:
    """Set up the preconditioner; 1: it is singular there."""
    problem = instance.given
    n = problem.memory.ida.y.shape[0]
    code: int = set_up_loops(t, array_at(y, n), cj, problem)
    return code


def apply_eliminated_preconditioner(
    instance: Any, t: float, y: Any, slopes: Any, right: Any, left: Any, cj: float
) -> int:
    """Apply the preconditioner to ``right``."""
    problem = instance.given
    n = problem.memory.ida.y.shape[0]
    apply_to_loops(array_at(y, n), array_at(right, n), array_at(left, n), problem)
    return 0


def no_error_weights(instance: Any, y: Any, out: Any) -> int:
    """IDA weighs the errors by its tolerances."""
    return NO_CALLBACK


_real, _place = types.float64, types.voidptr
CALLBACK_TYPES: dict[str, tuple[Any, ...]] = {  # of the arguments after the instance
    "residual": (_real, _place, _place, _place),
    "set_up_preconditioner": (_real, _place, _place, _real),
    "apply_preconditioner": (_real, _place, _place, _place, _place, _real),
    "matvec": (_place, _place),
    "jacobian": (_real, _real, _place, _place, _place),
    "error_weights": (_place, _place),
}
SUNDIALS_FAMILIES: dict[str, tuple[Any, ...]] = {  # callbacks of the families of mbfmu.native.families that call IDA
    "ida": (residual, set_up_preconditioner, apply_preconditioner, matvec, jacobian, error_weights),
    "tree_ida": (
        tree_residual, set_up_tree_preconditioner, apply_tree_preconditioner, no_matvec, no_jacobian,
        tree_error_weights,
    ),
    "eliminated_ida": (
        eliminated_residual, set_up_eliminated_preconditioner, apply_eliminated_preconditioner, no_matvec, no_jacobian,
        no_error_weights,
    ),
}  # fmt: skip


def callback_symbol(family: str, name: str) -> str:
    """Return the symbol of a callback of a family."""
    return f"mb_{family}_call_{name}"


def declarations(c_types: dict[Any, str], family: str) -> list[str]:
    """Return the lines of the C header that SUNDIALS and a family need; ``c_types``: those of arguments of kernels."""
    prefix = ["#ifdef _WIN32", '#define LIBRARY_NAME(name) "sundials_" name', "#else"]
    lines = [*prefix, '#define LIBRARY_NAME(name) "libsundials_" name', "#endif"]
    functions = (*FUNCTION_NAMES, *CONTEXT_FUNCTIONS)
    lines += [f"#define LIBRARY_COUNT {len(LIBRARIES)}", f"#define FUNCTION_COUNT {len(FUNCTION_NAMES)}"]
    lines.append(_array("library_names", (f'LIBRARY_NAME("{name}")' for name in LIBRARIES)))
    lines.append(_array("function_names", (f'"{name}"' for name in functions)))
    words = [f"WORD_{name.upper()} = {RESIDUAL + k}" for k, name in enumerate((*CALLBACKS, "user_data", *OBJECTS))]
    lines.append(f"enum {{{', '.join(words)}, WORD_COUNT = {N_WORDS}}};")
    for name, more in CALLBACK_TYPES.items():
        arguments = ", ".join(("int64_t *", "void **", "void *", *(c_types[word] for word in more)))
        lines.append(f"typedef int32_t Callback_{name}({arguments});")
    fields = (f"    Callback_{name} *{name};" for name in CALLBACK_TYPES)
    lines += ["typedef struct {", *fields, "} Callbacks;"]
    if family in SUNDIALS_FAMILIES:
        symbols = {name: callback_symbol(family, name) for name in CALLBACK_TYPES}
        lines += [f"Callback_{name} {symbol};" for name, symbol in symbols.items()]
        lines.append(f"static const Callbacks callbacks = {{{', '.join(symbols.values())}}};")
    return lines


def _array(name: str, entries: Iterable[str]) -> str:
    return f"static const char *const {name}[] = {{{', '.join(entries)}}};"
