"""What to take for an error one can accept: the cheapest solver, tolerance and resolution that keep it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import floor, inf, log10

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import Mechanism
from mbfmu.modeling.model import Model
from mbfmu.modeling.scene import Scene
from mbfmu.session.run import communication_points
from mbfmu.studies.compare import (
    COMPARISON_BUDGET,
    MAX_RUN_SHARE,
    Case,
    Progress,
    Row,
    as_scene,
    describe_run,
    evaluate_run,
    omitted_run,
    plan_runs,
)
from mbfmu.studies.comparison_report import describe_reference, label
from mbfmu.studies.error_target import Target, narrow_reference, read_target
from mbfmu.studies.held_inputs import describe_held_inputs
from mbfmu.studies.reference import Reference, reference
from mbfmu.studies.resolution import Resolution, resolution_text
from mbfmu.studies.timing import Budget, BudgetExceeded, CpuTimes, time_interleaved
from mbfmu.util.diagnostics import Diagnosed, Diagnostic
from mbfmu.util.errors import UserError
from mbfmu.util.text_table import format_tolerance
from mbfmu.util.units import read_unit
from solvers.stepper import Stepper

Array = NDArray[np.float64]

ABSOLUTE_TARGET_TOLERANCE = 1e-4  # tolerance that tight runs of large trees go by where the target is absolute
MIN_TRIED_TOLERANCE, MAX_TRIED_TOLERANCE = 1e-12, 1e-2
TARGET_SAFETY = 0.5  # of the target: what the next tolerance aims at, as if errors were proportional to it
MAX_TOLERANCE_RATIO = 0.3  # of a tolerance: the next one is no more than that
MIN_TOLERANCE_RATIO = 1e-3  # of a tolerance: nor less
LOOSENING_RATIO = 0.25  # of the target: runs with a smaller error may use a larger tolerance
STAGNATION_RATIO = 0.7  # of the last error: what improves by less is stuck
FAILED_RUN_RATIO = 30.0  # times the target: what a run that is not to be trusted counts for
MAX_TRIES = 10  # of a solver at a resolution
COST_MARGIN = 1.5  # times the cheapest: what has taken more is not followed
MIN_LIMITED_TIME = 1.0  # s; what takes less is not cut short, and run once more for its time
MAX_FINALISTS = 3
FINAL_ROUNDS = 5
SEARCH_SHARE = 0.6  # of the whole: share of the search, without the reference


@dataclass(frozen=True, kw_only=True)
class Recommendation(Diagnosed):
    """Recommended solver, tolerance and resolution.

    Attributes
    ----------
    row
        Recommended run, with its computing time and error.
    scene
        Scene with its solver, tolerance and resolution.
    sentence
        The recommendation as text.
    rows
        All evaluated runs in the order of the search; each ran once except the last few.
    diagnostics
        Notes on the reference, on runs that were omitted, and on inputs that remain at their start values.
    """

    row: Row
    scene: Scene
    sentence: str
    rows: list[Row]
    diagnostics: Sequence[Diagnostic]


def recommend_solver(
    subject: Scene | Model | Mechanism,
    target: float | str | Target,
    *,
    solvers: Sequence[str | type[Stepper]] | None = None,
    tolerances: Sequence[float] | None = None,
    resolutions: Sequence[Resolution] | None = None,
    outputs: Sequence[str] = (),
    budget: float = COMPARISON_BUDGET,
    progress: Progress | None = None,
) -> Recommendation:
    """Return the cheapest solver, tolerance and resolution whose error is within a target, of those that were tried.

    Cheap runs are first: each solver at each resolution begins with a large tolerance that is reduced towards the
    target, and runs that
    cost more than one that has met the target are skipped. The best ones are timed in interleaved runs.

    Parameters
    ----------
    subject
        A scene, a model or a mechanism.
    target
        Error relative to the range of each output (``1e-4``), or an absolute error with its unit (``"0.2 mm"``), which
        applies
        to the outputs with that unit.
    solvers, resolutions, budget
        Arguments of :func:`mbfmu.compare`.
    tolerances
        Tolerances to try; by default those that the target requires.
    outputs
        Outputs that must meet the target; by default all that :func:`mbfmu.compare` evaluates.
    progress
        Function that receives the name of a finished run and its share of the whole.

    Returns
    -------
    Recommendation
        Recommended run, and the scene with its solver, tolerance and resolution.

    Raises
    ------
    UserError
        The target is invalid, does not suit the outputs, is smaller than the uncertainty of the reference, or is not
        reached.
    """
    wanted_target, scene = read_target(target), as_scene(subject)
    steps, chosen, refused = plan_runs(scene, solvers, tolerances, resolutions)
    account, report = Budget(budget), progress or (lambda _what, _share: None)
    times = communication_points(scene.stop_time, scene.output_interval)
    finest = ABSOLUTE_TARGET_TOLERANCE if wanted_target.unit else max(MIN_TRIED_TOLERANCE, 0.1 * wanted_target.value)
    every = reference(
        scene, steps, times, finest, account, outputs, lambda what: report(what, (1.0 - SEARCH_SHARE) / len(steps))
    )
    reference_data = narrow_reference(every, wanted_target, outputs)
    search = SettingsSearch(scene, reference_data, wanted_target, times, account, refused)
    for k, settings in chosen.items():
        search.add(k, steps[k], list(dict.fromkeys(solver for solver, _ in settings)), tolerances)
    search.run(report)
    return search.choice()


@dataclass
class Candidate:
    """One solver at one resolution on its way to a target; ``given`` are the tolerances to try, loose ones first."""

    number: int
    resolution: Resolution
    solver: str
    given: list[float] | None
    tolerance: float
    taken: float = 0.0  # by the last run, s
    ratio: float = inf  # error of the last run over the target
    tries: int = 0
    loosening: bool = False
    too_loose: float = 0.0  # the tightest tolerance that was not enough

    def next(self, ratio: float) -> bool:
        """Set the next tolerance after a run with this error over the target; False: there is none to try."""
        self.tries += 1
        stuck = not self.loosening and self.tries > 2 and ratio > STAGNATION_RATIO * self.ratio
        within = ratio <= 1.0
        if self.given is not None:
            self.tolerance = self.given.pop(0) if self.given else 0.0
        elif within and self.too_loose:  # between the two, if that is worth a run, and no more
            between = round_to_digit((self.tolerance * self.too_loose) ** 0.5)
            self.loosening = ratio < LOOSENING_RATIO and not self.loosening
            self.tolerance = between
        elif within:
            self.loosening, self.tolerance = True, round_to_digit(self.tolerance / MAX_TOLERANCE_RATIO)
        else:
            self.too_loose = self.tolerance
            self.tolerance = round_to_digit(
                self.tolerance * max(MIN_TOLERANCE_RATIO, min(MAX_TOLERANCE_RATIO, TARGET_SAFETY / ratio))
            )
        self.ratio = ratio
        if within != self.loosening or stuck or self.tries == MAX_TRIES:
            return False
        return MIN_TRIED_TOLERANCE <= self.tolerance <= MAX_TRIED_TOLERANCE


class SettingsSearch:
    """Runs that are looked at, cheap ones first, till nothing can be cheaper than what reaches the target."""

    def __init__(
        self,
        scene: Scene,
        reference_data: Reference,
        target: Target,
        times: Array,
        budget: Budget,
        omitted: Sequence[str] = (),
    ) -> None:
        self.scene, self.reference, self.target, self.times, self.budget = scene, reference_data, target, times, budget
        scale, doubt = reference_data.motion.scale, reference_data.motion.doubt  # what is not known may add to an error
        self.limits = {
            name: target.of_range(unit, scale[name]) - doubt[name] / scale[name]
            for name, unit in reference_data.units.items()
        }
        self.rows: list[Row] = []
        self.omitted = list(omitted)
        self._candidates: list[Candidate] = []
        self._within: list[tuple[Case, Row]] = []

    def add(self, number: int, resolution: Resolution, solvers: Sequence[str], given: Sequence[float] | None) -> None:
        """Add solvers at a resolution to the search, unless the error of the resolution exceeds the target."""
        own, words = self.reference.tight[number], resolution_text(resolution) or "the scene"
        if own is None:
            self.omitted.append(f"{words}: there is no reference in the time given")
            return
        ratio = self._ratio(self.reference.errors(own.values))
        if own is not self.reference.motion and ratio > 1.0:
            self.omitted.append(f"{words}: at any tolerance {ratio:.2g} times the target")
            return
        first = round_to_digit(min(MAX_TRIED_TOLERANCE, max(MIN_TRIED_TOLERANCE, *self.limits.values())))
        for solver in solvers:
            ordered = sorted(given, reverse=True) if given else None
            begin = ordered.pop(0) if ordered else first
            self._candidates.append(Candidate(number, resolution, solver, ordered, begin))

    def run(self, progress: Progress) -> None:
        """Follow what can be the cheapest; runs that did well before are likely to."""
        cheapest, reported = inf, 0
        waiting = list(self._candidates)
        while waiting:
            candidate = min(waiting, key=lambda t: (t.taken, t.number))
            waiting.remove(candidate)
            if candidate.taken > COST_MARGIN * cheapest and not candidate.loosening:
                continue
            found = self._try(
                candidate, min(MAX_RUN_SHARE * self.budget.seconds, COST_MARGIN * max(cheapest, MIN_LIMITED_TIME))
            )
            resolution = resolution_text(candidate.resolution)
            what = f"{candidate.solver} {format_tolerance(candidate.tolerance)} {resolution}".strip()
            if found is not None:
                case, row = found
                ratio = self._ratio(self._errors(row)) if row.trusted else FAILED_RUN_RATIO
                if ratio <= 1.0:
                    self._within.append(found)
                    cheapest = min(cheapest, case.taken)
                candidate.taken = case.taken
                if candidate.next(ratio):
                    waiting.append(candidate)
            done = len(self._candidates) - len(waiting)
            progress(what, SEARCH_SHARE * (done - reported) / len(self._candidates))
            reported = done

    def _try(self, candidate: Candidate, most: float) -> tuple[Case, Row] | None:
        """Run a track's next tolerance; None: it cannot, or takes longer than what is there already."""
        model = self.scene.model.with_values(candidate.resolution)
        own = self.scene.changed(model=model, solver=candidate.solver, tolerance=candidate.tolerance)
        try:
            result, taken = self.budget.run(model, own.settings, self.times, most)
        except BudgetExceeded:
            why = (
                f"took more than {most:.3g} s"
                if self.budget.left
                else f"the budget of {self.budget.seconds:g} s is used"
            )
            self.omitted.append(f"{describe_run(own, candidate.resolution)}: {why}")
            return None
        except UserError as error:
            self.omitted.append(f"{describe_run(own, candidate.resolution)}: {error}")
            return None
        if taken < MIN_LIMITED_TIME:  # most of it may have gone to the outputs
            taken = self.budget.time(own)
        case = Case(scene=own, number=candidate.number, resolution=candidate.resolution, result=result, taken=taken)
        self.rows.append(evaluate_run(case, CpuTimes((taken,)), self.reference))
        return case, self.rows[-1]

    def _errors(self, row: Row) -> dict[str, float]:
        return {name: row.errors[name] / self.reference.motion.scale[name] for name in self.reference.units}

    def _ratio(self, errors: dict[str, float]) -> float:
        """Return the largest error over what is allowed of it."""
        return max(errors[name] / limit for name, limit in self.limits.items())

    def choice(self) -> Recommendation:
        """Return the cheapest settings within the target, by interleaved timing."""
        if not self._within:
            raise UserError(self._describe_no_choice())
        last = sorted(self._within, key=lambda found: found[0].taken)[:MAX_FINALISTS]
        spent = time_interleaved(
            [partial(self.budget.time, case.scene) for case, _ in last],
            FINAL_ROUNDS,
            expected=[case.taken for case, _ in last],
            left=lambda: self.budget.left,
        )
        rows = [evaluate_run(case, own, self.reference) for (case, _), own in zip(last, spent, strict=True)]
        k = min(range(len(rows)), key=lambda i: rows[i].cpu_s)
        row, scene = rows[k], last[k][0].scene
        return Recommendation(
            row=row, scene=scene, sentence=self._describe_choice(row), rows=self.rows,
            diagnostics=[
                Diagnostic.note("reference-solution", describe_reference(self.reference)),
                *map(omitted_run, self.omitted), *describe_held_inputs(scene.model.compile().inputs.variables),
            ],
        )  # fmt: skip

    def _describe_choice(self, row: Row) -> str:
        resolution = f" with {resolution_text(row.resolution)}" if row.resolution else ""
        doubt = self.reference.motion.doubt[self._worst(row)]
        known = f"Uncertainty of the reference {self._amount(self._worst(row), doubt)}" if doubt else "Exact reference"
        return (
            f"recommended: solver {row.solver}, tolerance {format_tolerance(row.rtol)}{resolution} "
            f"({format_time(row.cpu_s)} CPU "
            f"time). Expected error {self._error(row)}, target {self.target}. {known}. {len(self.rows)} runs tried"
        )

    def _worst(self, row: Row) -> str:
        errors = self._errors(row)
        return max(errors, key=lambda name: errors[name] / self.limits[name])

    def _error(self, row: Row) -> str:
        name = self._worst(row)
        return f"{self._amount(name, row.errors[name])} in {name}"

    def _amount(self, name: str, error: float) -> str:
        """Return an error (in the unit of its output) in the unit of the target."""
        if not self.target.unit:
            return f"{error / self.reference.motion.scale[name]:.1e} of the range"
        factor = read_unit(self.reference.units[name]).factor / read_unit(self.target.unit).factor
        return f"{error * factor:.2g} {self.target.unit}"

    def _describe_no_choice(self) -> str:
        """Report that no run is within the target, and the error of the nearest one."""
        ended = [row for row in self.rows if row.trusted]
        near = min(ended, key=lambda row: self._ratio(self._errors(row)), default=None)
        nearest = f"The nearest is {near.solver} {label(near)}, error {self._error(near)}. " if near else ""
        return f"no run reached the target {self.target}. {nearest}{'; '.join(self.omitted)}".rstrip(";. ")


def round_to_digit(tolerance: float) -> float:
    """Return a tolerance with one digit, no larger."""
    power_of_ten = floor(log10(tolerance) + 1e-9)
    return float(f"{floor(tolerance / 10.0**power_of_ten + 1e-9)}e{power_of_ten}")


def format_time(seconds: float) -> str:
    """Return a time for people."""
    return f"{seconds:.2g} s" if seconds >= 1.0 else f"{1e3 * seconds:.3g} ms"
