"""Comparison of the position with earlier ones in model exchange; functions are those of
:class:`.model_exchange.Formulation`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from solvers.compiled.kernel import jit_uncached

from .exchange_memory import COMPARED, COMPLETED, PREVIOUS


def comparisons(copy_branch: Any, copy_critical_point: Any, record_position: Any) -> dict[str, Callable[..., None]]:
    """Return what compares positions, by names.

    ``copy_branch`` and ``copy_critical_point`` are kernels (source, target) that copy all that is known of the branch,
    or of the critical point only, between the work of a solver and a branch of the exchange. ``record_position`` is a
    kernel (instance, t, taken) that lets P(x) at t be a position that later ones are compared with, a ``taken`` time
    after the last one (s).
    """

    @jit_uncached
    def keep_previous(instance: Any) -> None:
        exchange = instance.exchange
        copy_branch(instance.work, exchange.previous)
        copy_critical_point(exchange.before, exchange.previous)
        exchange.times[PREVIOUS] = exchange.times[COMPARED]

    @jit_uncached
    def compare_from(instance: Any, t: float) -> None:
        times = instance.exchange.times
        taken = abs(t - times[COMPARED])
        times[COMPARED] = t
        record_position(instance, t, taken)

    @jit_uncached
    def complete(instance: Any) -> None:
        exchange = instance.exchange
        copy_branch(instance.work, exchange.completed)
        exchange.times[COMPLETED] = exchange.times[COMPARED]

    @jit_uncached
    def go_back(instance: Any, t: float) -> None:
        exchange, times = instance.exchange, instance.exchange.times
        if t >= times[COMPARED]:
            return
        if times[COMPLETED] <= times[PREVIOUS] <= t:
            copy_branch(exchange.previous, instance.work)
            times[COMPARED] = times[PREVIOUS]
        else:
            copy_branch(exchange.completed, instance.work)
            times[COMPARED] = times[COMPLETED]

    @jit_uncached
    def keep_front(instance: Any) -> None:
        copy_branch(instance.work, instance.exchange.before)

    @jit_uncached
    def restore_front(instance: Any, t: float) -> None:
        copy_branch(instance.exchange.before, instance.work)
        instance.exchange.times[COMPARED] = t

    @jit_uncached
    def keep(instance: Any) -> None:
        copy_critical_point(instance.work, instance.exchange.before)

    @jit_uncached
    def restore(instance: Any) -> None:
        copy_critical_point(instance.exchange.before, instance.work)

    found = keep_previous, compare_from, complete, go_back, keep_front, restore_front, keep, restore
    names = "keep_previous", "compare_from", "complete", "go_back", "keep_front", "restore_front", "keep", "restore"
    return dict(zip(names, found, strict=True))
