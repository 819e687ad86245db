"""SUNDIALS IDA in the runtime of native FMUs: what it calls back, and declarations for C."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from solvers.compiled.ffi import array_at
from solvers.compiled.kernel import types
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
SUNDIALS_FAMILIES = ("ida",)  # families of mbfmu.native.families that call IDA


def residual(instance: Any, t: float, y: Any, slopes: Any, out: Any) -> int:
    """Evaluate the residual of IDA; vectors are given by the addresses of their entries, as below."""
    problem = instance.given
    n = problem.memory.unknowns.y.shape[0]
    evaluate_residual_at(t, array_at(y, n), array_at(slopes, n), array_at(out, n), problem)
    return 0


def set_up_preconditioner(instance: Any, t: float, y: Any, slopes: Any) -> int:
    """Set up the preconditioner."""
    problem = instance.given
    n = problem.memory.unknowns.y.shape[0]
    set_up_preconditioner_at(t, array_at(y, n), array_at(slopes, n), problem)
    return 0


def apply_preconditioner(instance: Any, t: float, y: Any, slopes: Any, right: Any, left: Any, cj: float) -> int:
    """Apply the preconditioner to ``right``."""
    problem = instance.given
    n = problem.memory.unknowns.y.shape[0]
    apply_preconditioner_at(t, array_at(y, n), array_at(slopes, n), array_at(right, n), array_at(left, n), cj, problem)
    return 0


def matvec(instance: Any, x: Any, product: Any) -> int:
    """Multiply Newton's matrix by ``x``."""
    problem = instance.given
    n = problem.memory.unknowns.y.shape[0]
    multiply_matrix(array_at(x, n), array_at(product, n), problem)
    return 0


def jacobian(instance: Any, t: float, cj: float, y: Any, slopes: Any, matrix: Any) -> int:
    """Fill Newton's matrix."""
    problem = instance.given
    n = problem.memory.unknowns.y.shape[0]
    evaluate_jacobian_at(t, cj, array_at(y, n), array_at(slopes, n), array_at(matrix, n * n), problem)
    return 0


def error_weights(instance: Any, y: Any, out: Any) -> int:
    """Weigh the errors of the unknowns."""
    problem = instance.given
    n = problem.memory.unknowns.y.shape[0]
    set_error_weights(array_at(y, n), array_at(out, n), problem)
    return 0


_real, _place = types.float64, types.voidptr
CALLBACK_ENTRIES: dict[str, tuple[Any, tuple[Any, ...]]] = {  # function, and types of its arguments after the instance
    "residual": (residual, (_real, _place, _place, _place)),
    "set_up_preconditioner": (set_up_preconditioner, (_real, _place, _place)),
    "apply_preconditioner": (apply_preconditioner, (_real, _place, _place, _place, _place, _real)),
    "matvec": (matvec, (_place, _place)),
    "jacobian": (jacobian, (_real, _real, _place, _place, _place)),
    "error_weights": (error_weights, (_place, _place)),
}


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
    for name, (_, more) in CALLBACK_ENTRIES.items():
        arguments = ", ".join(("int64_t *", "void **", "void *", *(c_types[word] for word in more)))
        lines.append(f"typedef int32_t Callback_{name}({arguments});")
    fields = (f"    Callback_{name} *{name};" for name in CALLBACK_ENTRIES)
    lines += ["typedef struct {", *fields, "} Callbacks;"]
    if family in SUNDIALS_FAMILIES:
        symbols = {name: callback_symbol(family, name) for name in CALLBACK_ENTRIES}
        lines += [f"Callback_{name} {symbol};" for name, symbol in symbols.items()]
        lines.append(f"static const Callbacks callbacks = {{{', '.join(symbols.values())}}};")
    return lines


def _array(name: str, entries: Iterable[str]) -> str:
    return f"static const char *const {name}[] = {{{', '.join(entries)}}};"
