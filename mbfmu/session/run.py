"""A direct run, without an FMU: a model's outputs over time."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mbfmu.mechanics import Mechanism
from mbfmu.mechanics.arrays.given_inputs import Given, GivenInput, GivenInputs
from mbfmu.mechanics.numbers import ascending_times, positive
from mbfmu.mechanics.signals import Signal
from mbfmu.modeling.model import Model, as_model
from mbfmu.modeling.replaced_inputs import is_approximated
from mbfmu.modeling.scene import MAX_OUTPUTS
from mbfmu.modeling.settings import Settings
from mbfmu.util.diagnostics import INACCURATE_CODES, Diagnostic, without_repeats
from mbfmu.util.errors import UserError

from .interrupts import interrupts_held
from .kept_starts import take_start
from .result import Result
from .simulation import Array, Simulation

__all__ = ["Result", "communication_points", "run", "simulate"]

FIRST_BATCH_SIZE = 100  # outputs recorded before progress is reported first
MIN_STOP_TIME = 1e-150  # s; solvers divide by squares of times, which must not be zero
SHORT_BATCH_TIME = 0.05  # s; after a batch that took less the next one is twice as large


def communication_points(stop_time: float, interval: float) -> Array:
    """Return 0, interval, 2 interval, ... and the stop time, s; UserError where there are none or too many."""
    stop_time, interval = positive("stop time", stop_time), positive("interval", interval)
    if stop_time < MIN_STOP_TIME:
        raise UserError(
            f"stop time is {stop_time!r} s; allowed: at least {MIN_STOP_TIME:g} s, because squares of shorter times "
            "are zero in floating-point numbers. Give a later stop time"
        )
    if stop_time / interval > MAX_OUTPUTS:
        raise UserError(
            f"interval is {interval!r} s for {stop_time!r} s; allowed: at most {MAX_OUTPUTS:g} points. Use "
            "a larger interval"
        )
    count = int(np.ceil(stop_time / interval * (1.0 - 1e-9)))
    times: Array = np.minimum(interval * np.arange(count + 1), stop_time)
    return times


def check_interval(stop_time: float, interval: float) -> None:
    """Refuse an interval, s, that was given for a run and is longer than it; raises UserError."""
    if interval > stop_time:
        raise UserError(
            f"interval is {interval!r} s, longer than the run of {stop_time!r} s; allowed: at most the stop time. Give "
            "a shorter interval or a later stop time"
        )


def simulate(
    model: Model | Mechanism,
    stop_time: float | None = None,
    *,
    interval: float | None = None,
    inputs: Mapping[str, Given] | None = None,
    watch: Callable[[Simulation], None] | None = None,
    **settings: Any,
) -> Result:
    """Simulate a model or a mechanism from its start until ``stop_time``.

    Parameters
    ----------
    model
        A model, or a mechanism without a model.
    stop_time, interval
        End of the run and time between outputs, s; by default those of the model.
    inputs
        Values by name: a number, or a motion for the whole run: a function of time (s), an expression such as
        ``"10 * sin(30 * t)"``, a pair (times, values) of arrays, a :class:`.Table` or another signal. These are
        evaluated at the solver's times, so that the result has the solver's accuracy at any ``interval``. Points of
        loads and of rates are joined by straight lines, those of driven positions by a cubic spline. A function must
        depend on time alone, and is called before the run. ``Result.inputs`` states how each input was treated.
    watch
        Function that receives the simulation at every output.
    **settings
        Settings, see :class:`~mbfmu.modeling.settings.Settings`: ``solver``, ``tolerance``, ``max_step``,
        ``start_at_equilibrium``,
        ``input_interpolation`` (of loads that ``watch`` sets by :meth:`.Simulation.set_input`, between two outputs) and
        others.

    Returns
    -------
    Result
        Outputs over time, statistics of the solver, and ``diagnostics``: notes, warnings and errors.

    Raises
    ------
    UserError
        The model, the times, the inputs or the settings are invalid. A run that stops early does not raise: ``failure``
        of the result contains the reason. The same holds if the code of a user-defined solver raises an exception.

    Warns
    -----
    RuntimeWarning
        During the run, if `ida` takes very many steps and a trial shows that another solver is far faster.
    """
    model = as_model(model)
    times = communication_points(
        model.stop_time if stop_time is None else stop_time, model.output_interval if interval is None else interval
    )
    if interval is not None:
        check_interval(float(times[-1]), interval)
    own: dict[str, Any] = {"solver": model.default_solver, "tolerance": model.tolerance}
    return run(model, Settings(**own | settings), times, watch=watch, inputs=inputs, report=warn_about_step_count)


def is_given_over_time(value: Any) -> bool:
    """Whether an input is given by more than one number."""
    return callable(value) or isinstance(value, str | Signal | tuple | list) or np.ndim(value) > 0


def warn_about_step_count(found: Diagnostic) -> None:
    """Issue a RuntimeWarning at once: the result, which contains the diagnostic too, may come much later."""
    warnings.warn(str(found), RuntimeWarning, stacklevel=2)


def _over_time(signals: Mapping[str, Signal]) -> dict[str, Any]:
    """Return signals that replace inputs as a run of known length takes them.

    Functions are approximated over the whole run, so that pulses which are shorter than a step are not missed.
    """
    return {name: signal.law if is_approximated(signal) else signal for name, signal in signals.items()}


def run(
    model: Model | Mechanism,
    settings: Settings,
    times: Array,
    progress: Callable[[float], None] | None = None,
    watch: Callable[[Simulation], None] | None = None,
    warn: Callable[[Diagnostic], None] | None = None,
    inputs: Mapping[str, Given] | None = None,
    report: Callable[[Diagnostic], None] | None = None,
) -> Result:
    """Run a model directly, without an FMU, and record its outputs at ``times``; stops at a failure.

    ``inputs`` are as :func:`simulate` takes them. ``watch`` is shown
    the simulation whenever its outputs have been read: its bodies are in place then.
    ``warn`` is called at once when the energy balance is violated, ``report`` (else ``warn``) when another solver is
    far faster. The run continues.

    Raises
    ------
    UserError
        Times that do not ascend, and what :class:`Simulation` raises.
    """
    times = ascending_times(times)
    if not len(times):
        raise UserError("times are empty; allowed: at least one time")
    if watch is not None and not callable(watch):
        raise UserError(f"watch is {watch!r}; allowed: a function that is shown the simulation")
    if not isinstance(inputs or {}, Mapping):
        raise UserError(f"inputs are {inputs!r}; allowed: numbers or functions of time by the names of inputs")
    given: dict[str, Any] = {name: value for name, value in (inputs or {}).items() if is_given_over_time(value)}
    numbers: dict[str, Any] = {name: value for name, value in (inputs or {}).items() if name not in given}
    model = as_model(model)
    if model.replaced_inputs:
        given, model = {**_over_time(model.replaced_inputs), **given}, replace(model)
    settings = settings.for_model(model)
    given_inputs = GivenInputs(given, numbers, times, settings.tolerance, set_later=watch is not None)
    start, duration = float(times[0]), float(times[-1] - times[0])
    kept = take_start(model, settings, given_inputs, times) if watch is None else None
    if kept is not None and kept.given_inputs is not None:
        given_inputs = kept.given_inputs
    simulation = Simulation(
        model, settings, start, numbers, given_inputs=given_inputs, duration=duration or None, kept=kept
    )
    simulation.step_count_check.end, simulation.report = float(times[-1]), report or warn
    begin = time.perf_counter()
    times, values = _record(simulation, times, given_inputs.held, watch, warn, progress)
    wall_time = time.perf_counter() - begin
    result = Result(
        t=times,
        values=values,
        variables=simulation.variables,
        statistics=simulation.statistics,
        wall_time=wall_time,
        name=simulation.model.name,
        settings=settings,
        diagnostics=without_repeats([*simulation.diagnostics, *given_inputs.diagnostics()]),
        inputs=given_inputs.summary(settings.input_interpolation),
        events=simulation.events,
    )
    if kept is not None:
        kept.keep()
    return result


def _record(
    simulation: Simulation,
    times: Array,
    varying: Sequence[GivenInput],
    watch: Callable[[Simulation], None] | None,
    warn: Callable[[Diagnostic], None] | None,
    progress: Callable[[float], None] | None,
) -> tuple[Array, Array]:
    """Advance a simulation that is at the first of some times, s; return the times reached and the outputs there.

    ``varying`` are the inputs that are held between two times; the other functions are those of :func:`run`.
    """
    values = np.zeros((len(times), len(simulation.variables)))
    values[0] = simulation.outputs()
    if watch is not None:
        watch(simulation)
    done, warned, batch_size = 1, False, FIRST_BATCH_SIZE
    with interrupts_held() as interrupt:
        while done < len(times):
            interrupt()
            for held in varying:
                simulation.set_input(held.name, held.value(float(times[done - 1])))
            rows, before = slice(done, done + (1 if watch or varying else batch_size)), time.perf_counter()
            done += simulation.record(times[rows], values[rows])
            batch_size *= 1 if time.perf_counter() - before > SHORT_BATCH_TIME else 2
            if warn is not None and not warned and simulation.inaccurate:
                warned = True
                warn(next(d for d in simulation.diagnostics if d.code in INACCURATE_CODES))
            if simulation.failed or simulation.ended:
                break
            if watch is not None:
                watch(simulation)
            if progress is not None:
                progress(float(times[done - 1]))
    times, values = times[:done], values[:done]
    if simulation.ended and not simulation.failed and simulation.t > times[-1]:
        times, values = np.append(times, simulation.t), np.vstack([values, simulation.outputs()])
        if watch is not None:
            watch(simulation)
    return times, values
