"""Run of a problem by one method, and its verdict."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.session.result import Result
from mbfmu.session.run import simulate
from mbfmu.session.simulation import Simulation
from mbfmu.studies.compare import solvers_of
from mbfmu.util.errors import UserError

from .problem import Array, Motion, Problem, Reference, Value

ERROR_FACTOR = 100.0  # allowed error, in tolerances and sensitivities: errors of many steps add up
UNCERTAINTY_FACTOR = 10.0  # allowed error, in uncertainties of the reference
LOST_PART = 0.1  # of the range of the quantity: a motion is compared as long as the allowed error is smaller
COMPARED_TIMES = 81
RIGHT, STOPPED, WARNED, WRONG = "right", "stopped", "warned", "WRONG"


@dataclass(frozen=True, kw_only=True)
class Line:
    """Line of the report: one problem by one method.

    Attributes
    ----------
    problem, source
        Name of the problem, and authors and years of its sources.
    quantity, unit
        Quantity that is compared, and its unit.
    method
        Solver, or the function that computes the numbers.
    tolerance
        Tolerance of the solver; None: there is none.
    output, time
        Output and time, s, at which the ratio of error and allowed error is largest; None: the problem is no motion.
    reference, value
        Reference and number of mbfmu there; None: there is no result.
    error, allowed
        Error and allowed error there; for problems that are no motions relative to the largest number of the reference.
    uncertainty
        Largest error of the reference.
    until
        End of the comparison, s; None: the problem is no motion.
    seconds
        CPU time without compilation, s.
    verdict, reason
        ``right``, ``stopped`` (right until an error message), ``warned`` (wrong, with a warning or an error message) or
        ``WRONG``; and the message or the difference.
    """

    problem: str
    source: str
    quantity: str
    unit: str
    method: str
    tolerance: float | None = None
    output: str = ""
    time: float | None = None
    reference: float | None = None
    value: float | None = None
    uncertainty: float = 0.0
    error: float | None = None
    allowed: float | None = None
    until: float | None = None
    seconds: float = 0.0
    verdict: str = WRONG
    reason: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name; numbers that are not finite, which JSON does not have, are None."""
        return {name: finite(value) for name, value in asdict(self).items()}


def finite(value: Any) -> Any:
    """Return a value, None in place of a number that is not finite."""
    return None if isinstance(value, float) and not isfinite(value) else value


def methods_of(problem: Problem, chosen: Sequence[str]) -> list[str]:
    """Return the solvers that are run for a problem; empty if none of the chosen ones accepts it."""
    if isinstance(problem, Value):
        return [problem.method]
    assert isinstance(problem, Motion)
    accepted = solvers_of(CompiledMechanism(problem.build()))
    return [name for name in problem.solvers if name in accepted and (not chosen or name in chosen)]


def check(problem: Problem, methods: Sequence[str], tolerances: Sequence[float]) -> Iterator[Line]:
    """Yield the lines of a problem."""
    if isinstance(problem, Value):
        yield check_value(problem)
        return
    assert isinstance(problem, Motion)
    times = np.linspace(0.0, problem.stop_time, COMPARED_TIMES)
    reference = problem.exact().at(times)
    for method in methods:
        run_motion(problem, method, max(tolerances))  # compiles
        for tolerance in tolerances:
            yield check_motion(problem, reference, method, tolerance)


class Run(NamedTuple):
    """Result of a simulation, the tolerance that the solver used, and the CPU time between first and last output, s."""

    result: Result
    tolerance: float
    seconds: float


def run_motion(problem: Motion, method: str, tolerance: float) -> Run:
    """Simulate a problem."""
    clock: list[float] = []
    least = 0.0

    def watch(simulation: Simulation) -> None:
        nonlocal least
        clock.append(time.process_time())
        least = simulation.stepper.min_rtol

    interval = problem.stop_time / (COMPARED_TIMES - 1)
    settings = {"solver": method, "tolerance": tolerance, **(problem.settings or {})}
    result = simulate(problem.build(), problem.stop_time, interval=interval, watch=watch, **settings)
    return Run(result, max(tolerance * result.statistics.coarser, least), clock[-1] - clock[0])


def check_motion(problem: Motion, reference: Reference, method: str, tolerance: float) -> Line:
    """Compare a simulation with the reference."""
    line = Line(
        problem=problem.name,
        source=problem.source_keys,
        quantity=problem.quantity,
        unit=problem.unit,
        method=method,
        tolerance=tolerance,
        uncertainty=reference.uncertainty,
    )
    try:
        result, used, seconds = run_motion(problem, method, tolerance)
    except UserError as refusal:
        return replace(line, verdict=STOPPED, reason=str(refusal))
    line = replace(line, seconds=seconds)
    values = np.column_stack([result[name] for name in problem.outputs])
    allowed = ERROR_FACTOR * used * reference.sensitivity
    allowed = allowed + UNCERTAINTY_FACTOR * reference.uncertainty + problem.model_error
    compared = compared_times(problem, reference, allowed)
    is_early = result.failed and len(values) <= compared.max(initial=0)
    compared = compared[compared < len(values)]
    if not len(compared):
        return replace(line, verdict=WARNED if is_early else WRONG, reason=result.failure or "nothing is compared")
    error = np.abs(values[compared] - reference.values[compared])
    ratio = np.where(np.isfinite(error), error / allowed[compared], np.inf)
    at, column = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    worst = int(compared[at])
    line = replace(
        line,
        output=problem.outputs[column],
        time=float(result.t[worst]),
        reference=float(reference.values[worst, column]),
        value=float(values[worst, column]),
        error=float(error[at, column]),
        allowed=float(allowed[worst, column]),
        until=float(result.t[compared[-1]]),
    )
    messages = [str(d) for d in result.diagnostics if d.severity != "note"]
    if ratio.max() <= 1.0:
        return replace(line, verdict=STOPPED if is_early else RIGHT, reason="; ".join(messages))
    difference = f"{problem.outputs[column]!r} differs by {ratio.max():.2g} times the allowed error"
    difference += f" at t = {result.t[worst]:g} s"
    if messages:
        return replace(line, verdict=WARNED, reason="; ".join([difference, *messages]))
    return replace(line, verdict=WRONG, reason=f"{difference}, without a warning")


def compared_times(problem: Motion, reference: Reference, allowed: Array) -> NDArray[np.intp]:
    """Return the numbers of the times at which a motion is compared.

    These are the times until errors of the tolerance may be as large as a part of the range of the quantity.
    """
    if problem.only_end:
        return np.array([len(allowed) - 1])
    size = np.ptp(reference.values, axis=0)
    lost = np.flatnonzero((allowed > LOST_PART * size).any(axis=1))
    return np.arange(1, int(lost[0]) if len(lost) else len(allowed))


def check_value(problem: Value) -> Line:
    """Compare numbers that are computed without a simulation with the reference."""
    reference = problem.reference()
    begin = time.process_time()
    line = Line(
        problem=problem.name,
        source=problem.source_keys,
        quantity=problem.quantity,
        unit=problem.unit,
        method=problem.method,
        reference=float(reference[0]),
        uncertainty=problem.uncertainty,
        allowed=problem.allowed + UNCERTAINTY_FACTOR * problem.uncertainty,
    )
    try:
        values = problem.measure(problem.build())
    except UserError as refusal:
        return replace(line, verdict=STOPPED, reason=str(refusal))
    worst = int(np.argmax(np.abs(values - reference)))
    error = float(np.abs(values - reference)[worst] / np.abs(reference).max())
    line = replace(line, reference=float(reference[worst]), value=float(values[worst]), error=error)
    line = replace(line, seconds=time.process_time() - begin)
    assert line.allowed is not None
    if error <= line.allowed:
        return replace(line, verdict=RIGHT)
    return replace(
        line, verdict=WRONG, reason=f"the relative error is {error / line.allowed:.2g} times the allowed error"
    )
