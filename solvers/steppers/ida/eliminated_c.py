"""The callbacks of :mod:`.eliminated_callbacks` with the signatures of C, for Python."""

from __future__ import annotations

from typing import Any

from solvers.compiled.ffi import array_at
from solvers.compiled.kernel import inlined
from solvers.compiled.template import specialize
from solvers.steppers.eliminated_newton import apply_preconditioner

from . import loop
from .eliminated_callbacks import accept_step, evaluate_residual, set_up_preconditioner
from .sundials import LOOP_CALLS, Callbacks, vector_data

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


def call_preconditioner_setup(t: float, y: Any, _slopes: Any, _res: Any, cj: float, problem: Any) -> int:
    """Set up the preconditioner."""
    return set_up_preconditioner(t, array_at(vector_data(y), size(problem)), cj, problem)


def call_preconditioner(
    _t: float, y: Any, _slopes: Any, _res: Any, right: Any, left: Any, _cj: float, _delta: float, problem: Any
) -> int:
    """Apply it."""
    n = size(problem)
    apply_preconditioner(
        array_at(vector_data(y), n), array_at(vector_data(right), n), array_at(vector_data(left), n), problem
    )
    return 0


ELIMINATED_CALLBACKS = Callbacks(call_residual, call_preconditioner_setup, call_preconditioner)
