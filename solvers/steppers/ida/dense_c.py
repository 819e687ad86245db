"""The callbacks of :mod:`.dense_callbacks` with the signatures of C, for Python."""

from __future__ import annotations

from typing import Any

from solvers.compiled.ffi import array_at
from solvers.compiled.kernel import inlined

from .dense_callbacks import (
    apply_preconditioner_at,
    evaluate_jacobian_at,
    evaluate_residual_at,
    multiply_matrix,
    set_error_weights,
    set_up_preconditioner_at,
)
from .sundials import Callbacks, matrix_data, vector_data


@inlined
def size(problem: Any) -> int:
    """Number of unknowns N."""
    n: int = problem.memory.unknowns.y.shape[0]
    return n


def call_residual(t: float, y: Any, slopes: Any, out: Any, problem: Any) -> int:
    """As IDA calls it, like those that follow."""
    n = size(problem)
    vectors = array_at(vector_data(y), n), array_at(vector_data(slopes), n), array_at(vector_data(out), n)
    evaluate_residual_at(t, vectors[0], vectors[1], vectors[2], problem)
    return 0


def call_preconditioner_setup(t: float, y: Any, slopes: Any, _res: Any, _cj: float, problem: Any) -> int:
    """Set up the preconditioner."""
    n = size(problem)
    set_up_preconditioner_at(t, array_at(vector_data(y), n), array_at(vector_data(slopes), n), problem)
    return 0


def call_preconditioner(
    t: float, y: Any, slopes: Any, _res: Any, right: Any, left: Any, cj: float, _delta: float, problem: Any
) -> int:
    """Apply it."""
    n = size(problem)
    at = array_at(vector_data(y), n), array_at(vector_data(slopes), n)
    sides = array_at(vector_data(right), n), array_at(vector_data(left), n)
    apply_preconditioner_at(t, at[0], at[1], sides[0], sides[1], cj, problem)
    return 0


def call_error_weights(y: Any, out: Any, problem: Any) -> int:
    """Weigh the unknowns."""
    n = size(problem)
    set_error_weights(array_at(vector_data(y), n), array_at(vector_data(out), n), problem)
    return 0


def call_matvec(
    _t: float, _y: Any, _slopes: Any, _res: Any, x: Any, product: Any, _cj: float, problem: Any, _a: Any, _b: Any
) -> int:
    """Multiply by the matrix."""
    n = size(problem)
    multiply_matrix(array_at(vector_data(x), n), array_at(vector_data(product), n), problem)
    return 0


def call_jacobian(
    t: float, cj: float, y: Any, slopes: Any, _res: Any, matrix: Any, problem: Any, _a: Any, _b: Any, _c: Any
) -> int:
    """Fill the matrix."""
    n = size(problem)
    at, out = (array_at(vector_data(y), n), array_at(vector_data(slopes), n)), array_at(matrix_data(matrix), n * n)
    evaluate_jacobian_at(t, cj, at[0], at[1], out, problem)
    return 0


# Old factors serve where nothing is near singular.
ITERATIVE_CALLBACKS = Callbacks(
    call_residual, call_preconditioner_setup, call_preconditioner, call_matvec, error_weights=call_error_weights
)
DENSE_CALLBACKS = Callbacks(call_residual, jacobian=call_jacobian, error_weights=call_error_weights)
