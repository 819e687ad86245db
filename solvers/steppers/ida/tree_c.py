"""The callbacks of :mod:`.tree_callbacks` with the signatures of C, for Python."""

from __future__ import annotations

from typing import Any

from solvers.compiled.ffi import array_at
from solvers.compiled.kernel import inlined
from solvers.compiled.template import specialize

from . import loop
from .sundials import LOOP_CALLS, Callbacks, vector_data
from .tree_callbacks import (
    accept_step,
    apply_preconditioner,
    evaluate_residual,
    multiply_matrix,
    set_error_weights,
    set_up_preconditioner,
)

step_until = specialize(loop.step_until, __name__, {**LOOP_CALLS, "accept": accept_step})


@inlined
def size(problem: Any) -> int:
    """Number of unknowns N."""
    n: int = problem.memory.ida.y.shape[0]
    return n


def call_residual(t: float, y: Any, slopes: Any, out: Any, problem: Any) -> int:
    """As IDA calls it, like those that follow."""
    n = size(problem)
    vectors = array_at(vector_data(y), n), array_at(vector_data(slopes), n), array_at(vector_data(out), n)
    evaluate_residual(t, vectors[0], vectors[1], vectors[2], problem)
    return 0


def call_preconditioner_setup(t: float, y: Any, slopes: Any, _res: Any, cj: float, problem: Any) -> int:
    """Set up the preconditioner."""
    n = size(problem)
    return set_up_preconditioner(t, array_at(vector_data(y), n), array_at(vector_data(slopes), n), cj, problem)


def call_preconditioner(
    _t: float, y: Any, _slopes: Any, _res: Any, right: Any, left: Any, _cj: float, _delta: float, problem: Any
) -> int:
    """Apply it."""
    n = size(problem)
    apply_preconditioner(
        array_at(vector_data(y), n), array_at(vector_data(right), n), array_at(vector_data(left), n), problem
    )
    return 0


def call_error_weights(y: Any, out: Any, problem: Any) -> int:
    """Weigh the unknowns."""
    n = size(problem)
    set_error_weights(array_at(vector_data(y), n), array_at(vector_data(out), n), problem)
    return 0


def call_matvec(
    t: float, y: Any, slopes: Any, _res: Any, x: Any, product: Any, cj: float, problem: Any, _one: Any, _two: Any
) -> int:
    """Multiply by the matrix."""
    n = size(problem)
    vectors = array_at(vector_data(y), n), array_at(vector_data(slopes), n), array_at(vector_data(x), n)
    multiply_matrix(t, vectors[0], vectors[1], vectors[2], cj, array_at(vector_data(product), n), problem)
    return 0


TREE_CALLBACKS = Callbacks(call_residual, call_preconditioner_setup, call_preconditioner)
# weights that are not those of IDA
WEIGHING_TREE_CALLBACKS = TREE_CALLBACKS._replace(error_weights=call_error_weights)
# forces that are not smooth
EXACT_TREE_CALLBACKS = WEIGHING_TREE_CALLBACKS._replace(matvec=call_matvec)
