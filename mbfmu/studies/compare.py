"""What accuracy costs in time: solvers at several tolerances and resolutions against the motion they should give."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.modeling.model import Model, as_model
from mbfmu.modeling.scene import Scene, default_scene
from mbfmu.session.result import Result
from mbfmu.session.run import communication_points
from mbfmu.studies.held_inputs import describe_held_inputs
from mbfmu.studies.reference import Reference, reference
from mbfmu.studies.resolution import Resolution, resolution_text, resolutions_of
from mbfmu.studies.timing import Budget, BudgetExceeded, CpuTimes, check_repeats, time_interleaved
from mbfmu.util.diagnostics import Diagnosed, Diagnostic
from mbfmu.util.errors import UserError
from mbfmu.util.text_table import format_tolerance
from solvers.stepper import Stepper
from solvers.steppers import (
    ELIMINATION_SOLVERS,
    SOLVERS,
    TREE_SOLVERS,
    UNCONSTRAINED_SOLVERS,
    describe_order_refusal,
    describe_refusal,
    drop_unlisted,
    eliminates_constraints,
)

DEFAULT_TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
RESOLUTION_TOLERANCES = (1e-4, 1e-6)  # at several resolutions
TREE_TOLERANCES = (1e-2, 1e-3, 1e-4)  # of large trees
BRANCH_TOLERANCE = 0.05  # rad; twice the error that the loosest tolerance leaves on the right branch
COMPARISON_BUDGET = 120.0  # s
MAX_RUN_SHARE = 1.0 / 20.0  # of the budget, for one run
TIMED_REPEATS = 5

History = tuple[NDArray[np.float64], NDArray[np.float64]]
Progress = Callable[[str, float], None]  # what is done, and the share of the whole that this makes


@dataclass(frozen=True, kw_only=True)
class Row(Diagnosed):
    """One solver at one tolerance and resolution.

    Attributes
    ----------
    study
        ``motion``; rows of :mod:`mbfmu.studies.settling` say ``settling``.
    resolution
        Values of the parameters that were varied, by name.
    cpu_s, spread, runs
        Median CPU time of the integration alone, without compilation, start and outputs, s; distance of the quartiles
        over the median; number of runs.
    steps
        None if the solver does not report it.
    error, worst
        Largest difference of an evaluated output from the reference over the whole run, divided by the output's range,
        and the name of that output. None if the run did not reach its end.
    time_error, space_error
        The same against a tight run of the same resolution, and of that run against the reference; the second is None
        where there is nothing to resolve.
    errors
        Error of every evaluated output by name, in its unit.
    energy_error
        Largest difference between the energy and what work has made of it, J; None where it is not checked.
    position_residual, velocity_residual
        Largest at the outputs, m and m/s.
    branch_jump
        Whether the motion left its branch.
    end_time
        Last good time, s.
    diagnostics
        Notes, warnings and errors of the run.
    """

    solver: str
    rtol: float
    resolution: dict[str, float]
    cpu_s: float
    spread: float
    runs: int
    steps: int | None
    rhs_evals: int
    error: float | None
    worst: str
    time_error: float | None
    space_error: float | None
    errors: dict[str, float]
    energy_error: float | None
    position_residual: float
    velocity_residual: float
    partition_switches: int
    branch_jump: bool
    end_time: float
    diagnostics: Sequence[Diagnostic] = ()
    study: str = "motion"

    @property
    def trusted(self) -> bool:
        """Whether it ran to its end, on its branch and in its energy balance."""
        return self.error is not None and not self.branch_jump and not self.inaccurate

    def as_dict(self) -> dict[str, Any]:
        """Return the row for JSON, with ``status``: the error of the run or ``ok``, and ``warning``."""
        return asdict(self) | {"status": self.failure or "ok", "warning": self.warning}


@dataclass(frozen=True, kw_only=True)
class Comparison(Diagnosed):
    """Result of a comparison.

    Attributes
    ----------
    rows
        Runs, with coarse resolutions and large tolerances first.
    energies
        Times and energy error (J) of each solver at ``tolerance`` and the finest resolution it ran at.
    tolerance
        Of the compared tolerances, the one nearest that of the scene.
    reference
        Reference with which the rows are compared.
    diagnostics
        Notes on runs that were omitted, with reasons, and on inputs that remain at their start values. Those of each
        run are in its row.
    """

    rows: list[Row]
    energies: dict[str, History]
    tolerance: float
    reference: Reference
    diagnostics: Sequence[Diagnostic] = ()

    def best(self) -> list[Row]:
        """Return the Pareto front: runs for which no cheaper run is as accurate. The cheapest is first.

        A run that is the reference itself, without error, is not included.
        """
        front: list[Row] = []
        for row in sorted(
            (row for row in self.rows if row.trusted and row.error), key=lambda row: (row.cpu_s, row.error)
        ):
            if not front or error_of_complete(row.error) < error_of_complete(front[-1].error):
                front.append(row)
        return front


def error_of_complete(error: float | None) -> float:
    """Return the error of a run that reached its end."""
    assert error is not None
    return error


def solvers_of(compiled: CompiledMechanism) -> tuple[str, ...]:
    """Return the solvers offered to users that differ from each other on a mechanism."""
    system = compiled.system
    same = tuple(UNCONSTRAINED_SOLVERS)[1:] if not system.m else ()  # where nothing is partitioned
    if eliminates_constraints("adams", system):
        same = tuple(ELIMINATION_SOLVERS)[1:]
    if system.has_matrices:
        return drop_unlisted(name for name in SOLVERS if name not in same)
    if not system.m:
        return drop_unlisted((*TREE_SOLVERS, *(name for name in UNCONSTRAINED_SOLVERS if name not in same)))
    dense = (name for name in SOLVERS if name not in (*TREE_SOLVERS, *same) and not describe_refusal(name, system))
    return drop_unlisted((*TREE_SOLVERS, *dense))


def as_scene(subject: Scene | Model | Mechanism) -> Scene:
    """Return a scene: itself, or that of a model or a mechanism."""
    return subject if isinstance(subject, Scene) else default_scene(as_model(subject))


def compare(
    subject: Scene | Model | Mechanism,
    *,
    solvers: Sequence[str | type[Stepper]] | None = None,
    tolerances: Sequence[float] | None = None,
    resolutions: Sequence[Resolution] | None = None,
    outputs: Sequence[str] = (),
    repeats: int = TIMED_REPEATS,
    budget: float = COMPARISON_BUDGET,
    progress: Progress | None = None,
) -> Comparison:
    """Run solvers at tolerances and resolutions: a scene, or a model for its default time.

    The error of a row is the largest error of an output over the run, divided by the range of that output. The
    reference is the exact motion if the model defines it, else that of two accurate runs, over several resolutions
    their limit. All rows are timed in interleaved rounds.

    Parameters
    ----------
    subject
        A scene, a model or a mechanism.
    solvers, tolerances
        Solvers, by name or as classes, and tolerances. Default: all solvers of mbfmu that differ on this mechanism, and
        1e-4 to 1e-10, 1e-4 and 1e-6 at several resolutions, or 1e-2 to 1e-4 for large models.
    resolutions
        Values of the model's parameters of resolution by name, such as ``[{"nx": 9, "nz": 7}]``; by default those that
        the model declares, see :func:`mbfmu.parameter`. ``[{}]``: the model unchanged.
    outputs
        Evaluated outputs; by default all that move freely and that are known accurately in the reference.
    repeats
        Number of timed runs of each row, within the budget.
    budget
        CPU time of all runs, s; cheap ones run first. Runs that take more than a twentieth of it are omitted and
        listed.
    progress
        Function that receives the name of a finished run and its share of the whole.

    Returns
    -------
    Comparison
        Runs with computing times, errors and energy errors, and the reference. ``best()`` is the Pareto front.

    Raises
    ------
    UserError
        A name or number is not allowed, nothing can run, or there is no reference.
    """
    scene = as_scene(subject)
    steps, chosen, refused = plan_runs(scene, solvers, tolerances, resolutions)
    check_repeats(repeats)
    account = Budget(budget)
    count = len(steps) + sum(map(len, chosen.values())) * (1 + repeats)
    report: Progress = progress or (lambda _what, _share: None)
    times = communication_points(scene.stop_time, scene.output_interval)
    finest = min(setting[1] for settings in chosen.values() for setting in settings)
    reference_data = reference(scene, steps, times, finest, account, outputs, lambda what: report(what, 1.0 / count))
    cases, left_out = _first_runs(
        scene, steps, chosen, reference_data, times, account, lambda what: report(what, 1.0 / count)
    )
    spent = time_interleaved(
        [partial(account.time, case.scene) for case in cases],
        repeats,
        expected=[case.taken for case in cases],
        left=lambda: account.left,
        progress=lambda what: report(what, 1.0 / count),
    )
    rows = [evaluate_run(case, own, reference_data) for case, own in zip(cases, spent, strict=True)]
    tolerance = min({row.rtol for row in rows}, key=lambda tol: abs(np.log(tol / scene.settings.tolerance)))
    shown = [case for case in cases if case.scene.settings.tolerance == tolerance]
    energies = {case.scene.settings.solver: _history(case.result) for case in sorted(shown, key=lambda c: c.number)}
    diagnostics = [*map(omitted_run, refused + left_out), *describe_held_inputs(scene.model.compile().inputs.variables)]
    return Comparison(
        rows=rows, energies=energies, tolerance=tolerance, reference=reference_data, diagnostics=diagnostics
    )


def omitted_run(text: str) -> Diagnostic:
    """Return a note on a run that was omitted, or stopped early; ``text`` names it and the reason."""
    return Diagnostic.parse(f"omitted: {text}", "note", "omitted-run")


Chosen = dict[int, list[tuple[str, float]]]  # solvers and tolerances by the number of a resolution


def plan_runs(
    scene: Scene,
    solvers: Sequence[str | type[Stepper]] | None,
    tolerances: Sequence[float] | None,
    values: Sequence[Resolution] | None,
) -> tuple[list[Resolution], Chosen, list[str]]:
    """Return the resolutions, the runs at each, and the reasons why solvers are left out; what is not given is
    chosen by the mechanism.
    """
    for name, given in (("solvers", solvers), ("tolerances", tolerances)):
        if given is not None and (isinstance(given, str) or not isinstance(given, Sequence | np.ndarray)):
            raise UserError(f"{name} are {given!r}; allowed: a list of them, such as [{given!r}]")
    steps = resolutions_of(scene.model, values)
    compiled_mechanisms = [scene.model.with_values(step).compile() for step in steps]
    small = all(compiled.system.has_matrices for compiled in compiled_mechanisms)
    usual = TREE_TOLERANCES if not small else DEFAULT_TOLERANCES if len(steps) == 1 else RESOLUTION_TOLERANCES
    tried = dict.fromkeys(usual if tolerances is None else tolerances)
    if not tried or (solvers is not None and not solvers):
        raise UserError(
            f"nothing to compare: solvers are {solvers!r} and tolerances {tolerances!r}; give at least one of each"
        )
    for tolerance in tried:
        scene.changed(tolerance=tolerance)
    requested = [scene.changed(solver=solver).settings.solver for solver in solvers or ()]
    ordered = sorted(tried, reverse=True)
    names = [dict.fromkeys(requested or solvers_of(compiled)) for compiled in compiled_mechanisms]
    order = scene.settings.max_order or None
    why = [
        {name: describe_refusal(name, compiled.system) or describe_order_refusal(name, order) for name in own}
        for compiled, own in zip(compiled_mechanisms, names, strict=True)
    ]
    chosen = {
        k: [(name, tolerance) for tolerance in ordered for name in own if not own[name]] for k, own in enumerate(why)
    }
    refused = list({name: text for own in reversed(why) for name, text in own.items() if text}.values())
    if not any(chosen.values()):
        raise UserError(f"nothing can be compared: {'; '.join(refused)}")
    return steps, chosen, refused


@dataclass(frozen=True, kw_only=True)
class Case:
    """A scene that ran: the number and the values of its resolution, and what its first run took, s."""

    scene: Scene
    number: int
    resolution: Resolution
    result: Result
    taken: float

    @property
    def words(self) -> str:
        """Solver, tolerance and resolution."""
        return describe_run(self.scene, self.resolution)


def describe_run(scene: Scene, resolution: Resolution) -> str:
    """Return solver, tolerance and resolution for people."""
    return f"{scene.settings.solver} {format_tolerance(scene.settings.tolerance)} {resolution_text(resolution)}".strip()


def _first_runs(
    scene: Scene,
    steps: Sequence[Resolution],
    chosen: Chosen,
    reference_data: Reference,
    times: NDArray[np.float64],
    budget: Budget,
    progress: Callable[[str], None],
) -> tuple[list[Case], list[str]]:
    """Run each once, cheap ones first; return those that ran, and what was left out."""
    most = MAX_RUN_SHARE * budget.seconds
    cases, left_out, slow = [], [], dict[str, tuple[float, int]]()  # tolerance and resolution by solver
    order = [(k, *what) for k, settings in chosen.items() for what in settings]
    for k, solver, tolerance in sorted(order, key=lambda what: (-what[2], what[0])):
        own = scene.changed(model=scene.model.with_values(steps[k]), solver=solver, tolerance=tolerance)
        named = describe_run(own, steps[k])
        at = slow.get(solver)
        try:
            if reference_data.tight[k] is None:
                left_out.append(f"{named}: no reference")
            elif at and tolerance <= at[0] and k >= at[1]:
                left_out.append(f"{named}: a run with a larger tolerance or coarser mesh took too long")
            elif budget.left < 0.5 * budget.seconds:
                left_out.append(f"{named}: half of the budget of {budget.seconds:g} s was used")
            else:
                result, taken = budget.run(own.model, own.settings, times, most)
                cases.append(Case(scene=own, number=k, resolution=steps[k], result=result, taken=taken))
        except BudgetExceeded:
            slow[solver] = min(slow.get(solver, (tolerance, k)), (tolerance, k), key=lambda s: s[1])
            left_out.append(f"{named}: took more than {most:.3g} s")
        except UserError as error:
            left_out.append(f"{named}: {error}")
        progress(named)
    if not cases:
        raise UserError(f"nothing could be compared: {'; '.join(left_out)}")
    return cases, left_out


def _history(result: Result) -> History:
    return result.t, result["energy_error"]


def evaluate_run(case: Case, cpu_times: CpuTimes, reference_data: Reference) -> Row:
    """Measure one run."""
    result, outputs = case.result, case.result.as_dict()
    own = reference_data.tight[case.number]
    assert own is not None
    ended = not result.failed
    errors = reference_data.errors(outputs) if ended else {}
    worst = max(errors, key=lambda name: errors[name], default="")
    resolved = own is not reference_data.motion
    gap = case.scene.model.branch_gap(outputs)
    energy_error = float(np.abs(outputs["energy_error"]).max())
    return Row(
        solver=case.scene.settings.solver,
        rtol=case.scene.settings.tolerance,
        resolution=dict(case.resolution),
        cpu_s=cpu_times.median,
        spread=cpu_times.spread,
        runs=len(cpu_times.times),
        steps=result.statistics.steps or None,
        rhs_evals=result.statistics.rhs_evals,
        error=errors[worst] if ended else None,
        worst=worst,
        time_error=max(reference_data.errors(outputs, own).values()) if ended else None,
        space_error=max(reference_data.errors(own.values).values()) if resolved else None,
        errors={name: error * reference_data.motion.scale[name] for name, error in errors.items()},
        energy_error=energy_error if np.isfinite(energy_error) else None,
        position_residual=largest(outputs, "position_residual"),
        velocity_residual=largest(outputs, "velocity_residual"),
        partition_switches=result.statistics.partition_switches,
        branch_jump=bool(gap is not None and gap.max() > BRANCH_TOLERANCE),
        end_time=float(result.t[-1]),
        diagnostics=result.diagnostics,
    )


def largest(outputs: dict[str, NDArray[np.float64]], name: str) -> float:
    """Return the largest value of an output; zero where the model does not have it."""
    return float(outputs[name].max()) if name in outputs else 0.0


def describe_outcome(row: Row) -> str:
    """Say in a few words how a run ended."""
    jump = "wrong branch" if row.branch_jump else ""
    lost = "inaccurate" if row.inaccurate else ""
    stop = f"stopped: {row.problems[0].text}" if row.failed else ""
    return "; ".join(filter(None, (lost, jump, stop))) or "ok"
