"""The costs of effects, and what each changes, by which a user decides what a scene needs.

The model runs as it is, and with one effect switched at a time: off where it was on, on where it was off. An effect
that is off has no entry in any array.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.errors import EquilibriumError, UserError
from mbfmu.mechanics import Plant
from mbfmu.model import Model
from mbfmu.settings import Settings
from mbfmu.simulation import Simulation
from mbfmu.steady.problem import equilibrium
from mbfmu.steady.state import GROWTH
from mbfmu.table import table
from solvers.compiled.kernel import kernel
from solvers.system import Equations

EVALUATIONS = 200
REPEATS = 7


@dataclass(frozen=True, kw_only=True)
class Entry:
    """The model as it is, or with one effect turned over.

    Attributes
    ----------
    case
        ``as it is``, ``with drag``, ``without gravity``.
    evaluation, run
        Time of one evaluation of the equations of motion, and median time of the run, s.
    frequency
        Lowest natural frequency of an oscillation about the steady state, Hz; None where there is none.
    stability
        Of the steady state, see :class:`mbfmu.steady.state.Equilibrium`; empty where there is none.
    outputs
        At the end of the run, by name.
    """

    case: str
    evaluation: float
    run: float
    frequency: float | None
    stability: str
    outputs: dict[str, float]


def costs(
    model: Model,
    settings: Settings,
    end: float,
    start: Mapping[str, float] | None = None,
    progress: Callable[[str], None] | None = None,
) -> list[Entry]:
    """Return an entry for the model as it is and one for each of its effects turned over.

    Parameters
    ----------
    model, settings, end
        What is run, how, and until when, s.
    start
        Coordinates by name that the steady states are looked for from, instead of the model's own.
    progress
        Called with every case that is done.

    Raises
    ------
    UserError
        The model has no effects.
    """
    if not model.effects:
        raise UserError(f"model {model.name!r} has no effects to turn on or off")
    cases = {"as it is": model}
    for effect, on in model.effects.items():
        active = any(getattr(model, name) != 0 for name in on)
        off = {name: type(getattr(model, name))(0) for name in on}
        cases[f"{'without' if active else 'with'} {effect}"] = model.with_values(off if active else on)
    entries = []
    for case, changed in cases.items():
        entries.append(_entry(case, changed, settings, end, start or {}))
        if progress is not None:
            progress(case)
    return entries


def _entry(case: str, model: Model, settings: Settings, end: float, start: Mapping[str, float]) -> Entry:
    frequency, stability = oscillation(model, start)
    runs = []
    for _ in range(3):
        simulation = Simulation(model, settings)
        begin = time.perf_counter()
        simulation.advance(end)
        runs.append(time.perf_counter() - begin)
    outputs = dict(zip((v.name for v in simulation.variables), map(float, simulation.outputs()), strict=True))
    return Entry(
        case=case,
        evaluation=time_of_evaluation(simulation.plant),
        run=statistics.median(runs),
        frequency=frequency,
        stability=stability,
        outputs=outputs,
    )


def oscillation(model: Model, start: Mapping[str, float]) -> tuple[float | None, str]:
    """Return :attr:`Entry.frequency` and :attr:`Entry.stability`; the steady state is looked for from ``start``."""
    try:
        found = equilibrium(model, start)
    except EquilibriumError:
        return None, ""
    floor = GROWTH * max((abs(mode.eigenvalue) for mode in found.modes), default=0.0)
    frequencies = [mode.frequency / (2.0 * np.pi) for mode in found.modes if mode.frequency > floor]
    return min(frequencies, default=None), found.stability


def time_of_evaluation(plant: Plant) -> float:
    """Return the time of one evaluation in a compiled loop, s, in a random state near the start."""
    call = evaluations(plant)
    call()
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        call()
        times.append((time.perf_counter() - begin) / EVALUATIONS)
    return min(times)  # what disturbs it only adds


def evaluations(plant: Plant) -> Callable[[], None]:
    """Return a call that evaluates the equations of motion ``EVALUATIONS`` times in a random state near the start.

    At rest numbers of the size of rounding would meet, whose products are slow to compute.
    """
    system = plant.system
    random = np.random.default_rng(0)
    q, v = plant.assembly.start_positions(), 0.1 * random.normal(size=system.n)
    system.apply(q, 0.01 * random.normal(size=system.n) * system.size)
    if not system.has_matrices:
        a, lam, qdot, tau = (np.zeros(size) for size in (system.n, system.m, system.nq, system.n))
        return lambda: _inverses(system.inverse, q, v, a, lam, system.held_data, qdot, tau, EVALUATIONS)
    equations = Equations.of(system, system.allocate_terms())
    return lambda: _dynamics(equations, q, v, EVALUATIONS)


@kernel
def _inverses(inverse: Any, q: Any, v: Any, a: Any, lam: Any, data: Any, qdot: Any, tau: Any, count: int) -> None:
    for _ in range(count):
        inverse(0.0, q, v, a, lam, data, qdot, tau)


@kernel
def _dynamics(eqs: Any, q: Any, v: Any, count: int) -> None:
    for _ in range(count):
        eqs.dynamics(0.0, q, v, eqs.data, eqs.terms)


def as_text(entries: list[Entry], shown: list[str]) -> str:
    """Return the entries as a table for people; ``shown`` are outputs at the end of the run."""
    bare = entries[0]
    rows = []
    for e in entries:
        frequency = "-" if e.frequency is None else f"{e.frequency:.5g}"
        more = "" if e is bare else f" ({100.0 * (e.evaluation / bare.evaluation - 1.0):+.0f} %)"
        rows.append(
            (
                e.case,
                f"{1e6 * e.evaluation:.3g}{more}",
                f"{e.run:.3g}",
                "unstable" if e.stability == "unstable" else frequency,
                *(f"{e.outputs[name]:.6g}" for name in shown),
            )
        )
    return table(("case", "evaluation [us]", "run [s]", "first mode [Hz]", *shown), rows)
