"""The loop over the steps of a compiled method, as templates (:mod:`solvers.compiled.template`).

A method is a module with the hooks below and a record CONTROL in its memory, which has the time reached ``t`` (s).
:func:`make_loop` and :func:`make_sample` return its kernels. A step may pass the requested time; the state
there is interpolated, so that the motion does not depend on the output times.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from numpy.typing import NDArray

from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8, i8
from solvers.compiled.template import require_hooks, specialize
from solvers.outcome import MAX_STEPS, OK
from solvers.system import Array

LOOP_HOOKS = ("prepare", "take_step", "end_step", "report")


class StepSettingsRecord(Record):
    """Options of every method; the record of a method adds its own."""

    rtol: f8  # of a step
    atol: f8  # in units of the coordinates
    max_step: f8  # s
    max_steps: i8  # in one call
    energy_check: i8  # 1: record energy and work
    works: i8  # 1: some force does work


@kernel
def set_step_options(options: Any, settings_array: Any) -> None:
    """Set the options of a run (``solvers.options.OPTIONS``) in a record with the fields of StepSettingsRecord."""
    requested, settings = options[0], settings_array[0]
    settings.rtol, settings.atol, settings.energy_check = requested.rtol, requested.absolute, requested.energy_check
    settings.max_step, settings.max_steps = requested.max_step, requested.max_steps


@contextmanager
def one_step_at_most(settings: Any) -> Iterator[None]:
    """Limit the loop with these settings (1,) to one step in this block."""
    allowed = int(settings["max_steps"][0])
    settings["max_steps"] = 1
    try:
        yield
    finally:
        settings["max_steps"] = allowed


class Loop(NamedTuple):
    """The kernels of a method."""

    advance: Callable[..., Any]
    advance_reported: Callable[..., Any]


class Integration(NamedTuple):
    """All that a loop integrates with, in one tuple: its kernels get one address and not every array at each call."""

    eqs: Any  # callbacks of the equations
    settings: NDArray[Any]  # (1,) record of the method's SETTINGS
    memory: Any  # of the method, with its ``control`` (1,)
    work: Any  # scratch of the formulation
    scales: Any  # solvers.energy_account.EnergyScales
    q: Array  # the reported state
    v: Array
    energy_account: Array


def prepare(integration: Any) -> int:
    """Hook: evaluate what the first step after a start or a change requires; return a code."""
    raise NotImplementedError


def take_step(integration: Any, target: float) -> int:
    """Hook: take one accepted step, or return the code of the reason why there is none."""
    raise NotImplementedError


def end_step(integration: Any) -> None:
    """Hook: record the accepted step, and limit the next one."""
    raise NotImplementedError


def report(integration: Any, code: int, target: float, q: Any, v: Any, energy_account: Any) -> int:
    """Hook: put the state at ``target`` into (q, v), or where the last step ended if ``code`` is not OK, and the energy
    account into ``energy_account`` (ACCOUNT_SIZE,); return a code.
    """
    raise NotImplementedError


def fill_row(integration: Any, t: float, q: Any, v: Any, a: Any, lam: Any, outputs: Any) -> int:
    """Hook: accelerations, multipliers and outputs of the system at the state reported last; return a code."""
    raise NotImplementedError


def advance(integration: Any, target: float, q: Any, v: Any, energy_account: Any) -> int:
    """Step until ``target`` is passed, and report the state there; return a code."""
    control, settings, eqs = integration.memory.control[0], integration.settings[0], integration.eqs
    code, taken = OK, 0
    while control.t < target:
        if taken >= settings.max_steps:
            code = MAX_STEPS
            break
        code = prepare(integration)
        if code != OK:
            break
        code = take_step(integration, target)
        if code != OK:
            break
        taken += 1
        end_step(integration)
        control.h = min(control.h, eqs.longest_load_step(control.hold, eqs.data))
    return report(integration, code, target, q, v, energy_account)


def advance_reported(integration: Any, target: float) -> int:
    """:func:`advance` for the reported state."""
    return advance(integration, target, integration.q, integration.v, integration.energy_account)


def sample(
    integration: Any, times: Any, q: Any, v: Any, a: Any, lam: Any, energy_account: Any, outputs: Any
) -> tuple[int, int]:
    """:func:`advance` to each of ``times`` in turn; state, accelerations, multipliers, energy account and outputs of
    the system in a row each.

    Returns the code and the number of complete rows; where ``advance`` failed the next row holds the last good state.
    """
    for i in range(times.shape[0]):
        code = advance(integration, times[i], q[i], v[i], energy_account[i])
        if code == OK:
            code = fill_row(integration, times[i], q[i], v[i], a[i], lam[i], outputs[i])
        if code != OK:
            return code, i
    return OK, times.shape[0]


def make_loop(module: str, **hooks: Any) -> Loop:
    """Return the kernels of a method by its hooks; ``module`` is the name of its module."""
    require_hooks(LOOP_HOOKS, module, hooks)
    own = specialize(advance, module, hooks)
    return Loop(own, specialize(advance_reported, module, {"advance": own}))


def make_sample(module: str, **hooks: Any) -> Callable[..., Any]:
    """Return the kernel ``sample`` of a method by its ``advance`` and its hook ``fill_row``."""
    require_hooks(("advance", "fill_row"), module, hooks)
    return specialize(sample, module, hooks)
