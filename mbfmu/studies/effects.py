"""The costs of effects, and what each changes, by which a user decides what a scene needs.

The model runs as it is, and with one effect switched at a time: off where it was on, on where it was off. An effect
that is off has no entry in any array. What an effect changes is the largest difference of an output over the whole run;
what the tolerance leaves open is that of a run at a tenth of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.modeling.model import Model
from mbfmu.modeling.scene import Scene, default_scene
from mbfmu.modeling.settings import Settings
from mbfmu.session.result import Result
from mbfmu.session.run import communication_points, run
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.studies.reference import constant_outputs, scales
from mbfmu.studies.timing import Budget, CpuTimes, cpu_time, time_interleaved
from mbfmu.util.errors import EquilibriumError, UserError
from mbfmu.util.text_table import format_table
from solvers.compiled.kernel import kernel
from solvers.system import Equations

if TYPE_CHECKING:
    from solvers.compiled.record import Reals

TIMED_EVALUATIONS = 200
EVALUATION_REPEATS = 7
EFFECT_ROUNDS = 3
EFFECTS_BUDGET = 60.0  # s; for the timed runs after the first round
MIN_RANGE_RATIO = 1e-3  # of the largest range in a unit: what moves less is compared with that
MIN_CHANGE = 1e-3  # of the range of an output: a change that counts
EFFECT_TOLERANCE_FACTOR = 0.1  # of the tolerance
MIN_EFFECT_TOLERANCE = 1e-12


@dataclass(frozen=True, kw_only=True)
class Entry:
    """The model as it is, or with one effect turned over.

    Attributes
    ----------
    case
        ``as defined``, ``with drag``, ``without gravity``.
    values
        Parameters of the effect with their units, as they are in this case; of the model as it is those that are on.
    evaluation, run
        CPU times of one evaluation of the equations of motion and of the run.
    frequency
        Lowest natural frequency of an oscillation about the steady state, Hz; None where there is none.
    stability
        Of the steady state, see :class:`mbfmu.steady.state.Equilibrium`; empty where there is none.
    result
        The run.
    changes
        By how much outputs differ at most from those of the model as it is, of their ranges, by name; those of that
        model from a run at a tenth of the tolerance. Empty where the run ended early.
    scale
        The ranges, by name, in the units of the outputs: the larger one of both runs, and no less than a thousandth of
        the largest range in that unit.
    advice
        Recommendation for the effect, as text.
    """

    case: str
    values: str
    evaluation: CpuTimes
    run: CpuTimes
    frequency: float | None
    stability: str
    result: Result
    changes: dict[str, float]
    scale: dict[str, float]
    advice: str = ""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A model with an effect turned over (empty: none), and whether that was on before."""

    name: str
    effect: str
    was_on: bool
    values: str
    model: Model


def cases(model: Model) -> list[Case]:
    """Return the model as it is, and with each effect turned over."""
    found, on_now = [], []
    for effect, on in model.effects.items():
        if not isinstance(on, Mapping):
            raise UserError(
                f"effects of model {model.name!r}: {effect!r} is {on!r}; allowed: values that switch it on, by "
                "the names of parameters, such as {'damping': 2.0}"
            )
        active = any(getattr(model, name) != 0 for name in on)
        off = {name: type(getattr(model, name))(0) for name in on}
        other = model.with_values(off if active else on)
        on_now += [parameters_text(model, on)] if active else []
        name, values = f"{'without' if active else 'with'} {effect}", parameters_text(other, on)
        found.append(Case(name=name, effect=effect, was_on=active, values=values, model=other))
    as_is = Case(name="as defined", effect="", was_on=True, values=", ".join(on_now) or "all off", model=model)
    return [as_is, *found]


def parameters_text(model: Model, names: Mapping[str, Any]) -> str:
    """Return parameters of a model with their values and units."""
    units = {p.name: "" if p.unit == "1" else f" {p.unit}" for p in model.parameters()}
    values = {name: getattr(model, name) for name in names}
    texts = {name: str(value).lower() if isinstance(value, bool) else f"{value:g}" for name, value in values.items()}
    return ", ".join(f"{name} = {value}{units[name]}" for name, value in texts.items())


def costs(
    model: Model,
    settings: Settings,
    end: float,
    start: Mapping[str, float] | None = None,
    progress: Callable[[str], None] | None = None,
    relevant: Sequence[str] = (),
) -> list[Entry]:
    """Return an entry for the model as it is and one for each of its effects turned over.

    Parameters
    ----------
    model, settings, end
        What is run, how, and until when, s.
    start
        Coordinates by name that the steady states are looked for from, instead of the model's own.
    progress
        Called with every case that is done, and every timed run.
    relevant
        Outputs by which the benefit of an effect is evaluated; by default all.

    Raises
    ------
    UserError
        The model has no effects.
    """
    if not model.effects:
        raise UserError(
            f"model {model.name!r} has no optional effects; a model declares them in its class attribute effects"
        )
    report = progress or (lambda _: None)
    times = communication_points(end, min(model.output_interval, end))
    found = cases(model)
    steady = [oscillation(case.model, start or {}) for case in found]
    results = []
    for case in found:
        results.append(run(case.model, settings, times))
        report(case.name)
    compiled_mechanisms = [case.model.compile() for case in found]
    tighter = run(
        model,
        replace(settings, tolerance=max(MIN_EFFECT_TOLERANCE, EFFECT_TOLERANCE_FACTOR * settings.tolerance)),
        times,
    )
    others = zip([tighter, *results[1:]], compiled_mechanisms, strict=True)
    differences = [changes(results[0], other, compiled_mechanisms[0], own) for other, own in others]
    single = time_interleaved([evaluations(compiled) for compiled in compiled_mechanisms], EVALUATION_REPEATS)
    scenes = [replace(default_scene(case.model), settings=settings, stop_time=end) for case in found]
    whole = timed(scenes, [result.wall_time for result in results], report)
    noise = {name: change for name, (change, _) in differences[0].items()}
    entries = []
    for case, result, own, evaluation, spent, (frequency, stability) in zip(
        found, results, differences, single, whole, steady, strict=True
    ):
        entries.append(
            Entry(
                case=case.name,
                values=case.values,
                evaluation=evaluation,
                run=spent,
                frequency=frequency,
                stability=stability,
                result=result,
                changes={name: change for name, (change, _) in own.items()},
                scale={name: scale for name, (_, scale) in own.items()},
                advice=advice(case, result, {name: change for name, (change, _) in own.items()}, noise, relevant),
            )
        )
    return entries


def timed(scenes: Sequence[Scene], expected: Sequence[float], report: Callable[[str], None]) -> list[CpuTimes]:
    """Return the CPU times of the runs of scenes, in turn."""
    account = Budget(EFFECTS_BUDGET)
    runs = [partial(account.time, scene) for scene in scenes]
    return time_interleaved(runs, EFFECT_ROUNDS, expected=expected, left=lambda: account.left, progress=report)


def changes(
    before: Result, after: Result, compiled: CompiledMechanism, other: CompiledMechanism
) -> dict[str, tuple[float, float]]:
    """Return by name how far outputs differ at most over the run, of their range, and that range.

    What moves in neither run is left out. Empty where a run ended early.
    """
    if before.failed or after.failed:
        return {}
    first, second = scales(before), scales(after)
    moved, moves = set(first) - constant_outputs(before, compiled), set(second) - constant_outputs(after, other)
    names = [name for name in first if name in second and (name in moved or name in moves)]
    largest = {unit: max(first[n] for n in names if before.unit(n) == unit) for unit in map(before.unit, names)}
    ranges = {name: max(first[name], second[name], MIN_RANGE_RATIO * largest[before.unit(name)]) for name in names}
    return {name: (float(np.abs(after[name] - before[name]).max()) / ranges[name], ranges[name]) for name in names}


def advice(
    case: Case, result: Result, found: Mapping[str, float], noise: Mapping[str, float], relevant: Sequence[str]
) -> str:
    """Return the recommendation for an effect: keep it, switch it on or off, or leave it off."""
    if not case.effect:
        return ""
    if not found:
        return f"{case.effect}: {case.name} the run ends early: {result.problems[0].text}"
    seen = {name: change for name, change in found.items() if name in (relevant or found)}
    large = {name: change for name, change in seen.items() if change > MIN_CHANGE}
    clear = {name: change for name, change in large.items() if change > 2.0 * noise.get(name, 0.0)}
    if clear:
        name = max(clear, key=lambda name: clear[name])
        what = "keep it on" if case.was_on else "switch it on where it acts"
        return f"{case.effect} changes {name} by {100.0 * clear[name]:.3g} % of its range: {what}"
    if large:
        name = max(large, key=lambda name: large[name])
        return (
            f"{case.effect} changes no output by more than the integration error, {100.0 * noise[name]:.2g} % of the "
            f"range of {name}: use a smaller tolerance to decide"
        )
    what = "switch it off" if case.was_on else "leave it off"
    return f"{case.effect} changes no output by more than {100.0 * MIN_CHANGE:g} %: {what}"


def oscillation(model: Model, start: Mapping[str, float]) -> tuple[float | None, str]:
    """Return :attr:`Entry.frequency` and :attr:`Entry.stability`; the steady state is looked for from ``start``."""
    try:
        found = equilibrium(model, start)
    except EquilibriumError:
        return None, ""
    frequencies = [mode.frequency / (2.0 * np.pi) for mode in found.modes if mode.frequency]
    return min(frequencies, default=None), found.stability


def time_of_evaluation(compiled: CompiledMechanism) -> float:
    """Return the CPU time of one evaluation in a compiled loop, s, in a random state near the start."""
    call = evaluations(compiled)
    return min(call() for _ in range(EVALUATION_REPEATS))  # what disturbs it only adds


def evaluations(compiled: CompiledMechanism) -> Callable[[], float]:
    """Return a call that evaluates the equations of motion in a random state near the start, and returns the CPU time
    of one evaluation, s.

    At rest numbers of the size of rounding would meet, whose products are slow to compute.
    """
    system = compiled.system
    random = np.random.default_rng(0)
    q, v = compiled.assembly.start_positions(), 0.1 * random.normal(size=system.n)
    system.apply(q, 0.01 * random.normal(size=system.n) * system.size)
    if system.has_matrices:
        equations = Equations.of(system, system.allocate_terms())
        loop = partial(_dynamics, equations, q, v, TIMED_EVALUATIONS)
    else:
        a, lam, qdot, tau = (np.zeros(size) for size in (system.n, system.m, system.nq, system.n))
        loop = partial(_inverses, system.inverse, q, v, a, lam, system.pinned_data, qdot, tau, TIMED_EVALUATIONS)
    loop()  # compiled now
    return lambda: cpu_time(loop) / TIMED_EVALUATIONS


@kernel
def _inverses(
    inverse: Any, q: Reals, v: Reals, a: Reals, lam: Reals, data: Any, qdot: Reals, tau: Reals, count: int
) -> None:
    for _ in range(count):
        inverse(0.0, q, v, a, lam, data, qdot, tau)


@kernel
def _dynamics(eqs: Any, q: Reals, v: Reals, count: int) -> None:
    for _ in range(count):
        eqs.dynamics(0.0, q, v, eqs.data, eqs.terms)


def as_text(entries: Sequence[Entry], shown: Sequence[str]) -> str:
    """Return the entries as a table for people, and what to do; ``shown`` are outputs whose changes are columns."""
    bare = entries[0]
    rows = [
        (
            e.case,
            e.values,
            f"{1e6 * e.evaluation.median:.3g}{more(e.evaluation, bare.evaluation)}",
            f"{e.run.median:.3g}{more(e.run, bare.run)}",
            "unstable" if e.stability == "unstable" else "-" if e.frequency is None else f"{e.frequency:.5g}",
            *(change_text(e, name) for name in shown),
        )
        for e in entries
    ]
    units = {v.name: v.unit for e in entries for v in e.result.variables}
    heads = [f"{name} (range {bare.scale[name]:.3g} {units[name]})" if name in bare.scale else name for name in shown]
    header = ("case", "parameters", "evaluation [us]", "CPU time of the run [s]", "first mode [Hz]", *heads)
    explanation = (
        "changes: largest difference from the first line over the whole run, relative to the range of the output; in "
        "the first line the integration error"
    )
    return "\n".join([format_table(header, rows), "", explanation, *(e.advice for e in entries if e.advice)])


def more(own: CpuTimes, bare: CpuTimes) -> str:
    """Return by how much a time differs from that of the model as it is, with the spread of both."""
    if own is bare:
        return f" (+-{50.0 * own.spread:.0f} %)"
    spread = 50.0 * (own.spread + bare.spread)
    return f" ({100.0 * (own.median / bare.median - 1.0):+.0f} +-{spread:.0f} %)"


def change_text(entry: Entry, name: str) -> str:
    """Return what an effect changes of an output."""
    return f"{100.0 * entry.changes[name]:.2g} %" if name in entry.changes else "-"
