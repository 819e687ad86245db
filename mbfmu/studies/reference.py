"""Reference of comparisons: the correct motion, its uncertainty, and the outputs that are evaluated.

At each resolution a pair of tight runs gives the motion of the discretized model; their difference is its uncertainty.
Over several resolutions these are extrapolated to the motion of the model itself. Data of the model replace either:
:meth:`mbfmu.Model.exact`, :meth:`mbfmu.Model.independent`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import log10

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.modeling.model import Model
from mbfmu.modeling.scene import Scene
from mbfmu.modeling.settings import Settings
from mbfmu.modeling.variables import ENERGY_OUTPUTS
from mbfmu.plotting.time_series import RESIDUAL_NAME_ENDINGS
from mbfmu.session.result import Result
from mbfmu.studies.resolution import Resolution, limit, moving_places, resolution_text, size
from mbfmu.studies.timing import Budget, BudgetExceeded
from mbfmu.util.errors import UserError, suggest
from mbfmu.util.text_table import format_tolerance
from solvers.steppers import describe_refusal

Array = NDArray[np.float64]
Runs = tuple[tuple[str, float], tuple[str, float]]  # solver and tolerance of the reference, and of the second run

MAX_OUTPUT_UNCERTAINTY = 0.01  # of its range: an output with a larger uncertainty is not evaluated,
# nor, if others are left, one with an uncertainty above this multiple of the smallest tolerance
MAX_UNCERTAINTY_FACTOR = 100.0
CONSTANT_OUTPUT_RATIO = 1e-9  # of its size: an output that moves less does not move
TIGHT_RUNS: tuple[Runs, ...] = (
    (("adams", 1e-12), ("adams", 1e-11)),
    (("radau", 1e-12), ("radau", 1e-11)),
    (("radau", 1e-10), ("radau", 1e-9)),
    (("ida", 1e-9), ("ida", 1e-8)),
    (("radau", 1e-7), ("radau", 1e-6)),
)
TREE_TIGHT_RUNS: Runs = (("adams", 1e-9), ("adams", 1e-8))  # of large trees
TIGHT_TOLERANCE_FACTOR = 0.1  # of the finest tolerance: that of the tight runs of large trees, at first
MAX_TIGHT_TOLERANCE = 1e-4  # at last
MIN_TIGHT_TOLERANCE = 1e-12
TIGHT_RUN_SHARE = 1.0 / 12.0  # of the budget, for a tight run,
LAST_PAIR_SHARE = 1.0 / 4.0  # and for one of the last pair that there is to try


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Outputs over time by name, their uncertainties (in their units), their ranges, and their source."""

    values: dict[str, Array]
    doubt: dict[str, float]
    scale: dict[str, float]
    source: str


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Reference with which runs are compared.

    Attributes
    ----------
    motion
        That of the model itself.
    tight
        That of the model at each resolution; None: no tight run ended in its time.
    units
        Units of the evaluated outputs, by name.
    not_evaluated
        Reasons why outputs are not evaluated, by name.
    orders
        Orders of convergence that were observed, by output.
    """

    motion: Motion
    tight: list[Motion | None]
    units: dict[str, str]
    not_evaluated: dict[str, str]
    orders: dict[str, float]

    @property
    def doubt(self) -> tuple[float, str]:
        """Largest uncertainty of the reference, divided by an output's range, and the name of that output."""
        known = self.motion
        return max((known.doubt[name] / known.scale[name], name) for name in self.units)

    def errors(self, values: dict[str, Array], other: Motion | None = None) -> dict[str, float]:
        """Return the largest difference of outputs over the run, of their ranges; ``other`` in place of the motion."""
        correct = (other or self.motion).values
        scale = self.motion.scale
        return {name: float(np.abs(values[name] - correct[name]).max()) / scale[name] for name in self.units}


def scales(result: Result) -> dict[str, float]:
    """Return the range of every output that is no residual; of an energy at least what was exchanged."""
    exchanged = float(np.nan_to_num(result["energy_throughput"][-1]))
    own = [v for v in result.variables if not v.name.endswith(RESIDUAL_NAME_ENDINGS) and v not in ENERGY_OUTPUTS]
    ranges = {v.name: float(np.ptp(result[v.name])) for v in own}
    return {v.name: max(ranges[v.name], exchanged) if v.unit == "J" else ranges[v.name] for v in own}


def constant_outputs(result: Result, compiled: CompiledMechanism) -> set[str]:
    """Return the outputs that do not move but for rounding."""
    units = {v.name: v.unit for v in compiled.outputs}
    sizes = {name: float(np.abs(result[name]).max()) + compiled.nominal(unit) for name, unit in units.items()}
    return {name for name, scale in scales(result).items() if not scale > CONSTANT_OUTPUT_RATIO * sizes[name]}


def driven_outputs(compiled: CompiledMechanism) -> set[str]:
    """Return the outputs that nothing free changes at the start."""
    system, random = compiled.system, np.random.default_rng(0)
    q, v = compiled.assemble()
    seen = []
    for part in (0.0, 0.1):
        there = q.copy()
        system.apply(there, part * random.normal(size=system.n) * system.size)
        dv, a, lam = (part * random.normal(size=count) for count in (system.n, system.n, system.m))
        out = np.zeros(len(compiled.outputs))
        compiled.observe(0.0, there, v + dv, a, lam, out)
        seen.append(out)
    same = seen[0] == seen[1]
    return {variable.name for variable, alike in zip(compiled.outputs, same, strict=True) if alike}


def tight_runs(compiled: CompiledMechanism, finest: float) -> tuple[Runs, ...]:
    """Return what to try for the motion of a mechanism, the best first; ``finest`` is its smallest tolerance."""
    system = compiled.system
    if system.has_matrices:
        return tuple(pair for pair in TIGHT_RUNS if not describe_refusal(pair[0][0], system))
    tolerance = max(MIN_TIGHT_TOLERANCE, TIGHT_TOLERANCE_FACTOR * finest)
    tolerances = [tolerance * 10.0**k for k in range(1 + max(0, round(log10(MAX_TIGHT_TOLERANCE / tolerance))))]
    pairs = (((("esdirk", tol), ("ida", tol)), (("ida", tol), ("ida", 10.0 * tol))) for tol in tolerances)
    implicit = [pair for two in pairs for pair in two]
    return (*implicit,) if system.m or describe_refusal("adams", system) else (TREE_TIGHT_RUNS, *implicit)


def tight(
    scene: Scene, times: Array, runs: Sequence[Runs], budget: Budget, hopeless: dict[Runs, str]
) -> tuple[Motion, Result] | None:
    """Return the motion of a scene by the first pair of runs that can be trusted, and its run; None: there is no such.

    Why a pair cannot is added to ``hopeless``; what is in there is not tried.
    """
    for pair in (pair for pair in runs if pair not in hopeless):
        share = (
            0.5 * TIGHT_RUN_SHARE
            if pair is TREE_TIGHT_RUNS
            else LAST_PAIR_SHARE
            if pair == runs[-1]
            else TIGHT_RUN_SHARE
        )
        most = share * budget.seconds
        solver, tolerance = pair[0]
        try:
            own, other = (budget.run(scene.model, _tight(scene, *one), times, most)[0] for one in pair)
        except BudgetExceeded:
            hopeless[pair] = f"{solver} at {format_tolerance(tolerance)} takes more than {min(most, budget.left):.3g} s"
            continue
        if wrong := [d for run in (own, other) if run.failed or run.inaccurate for d in run.problems]:
            hopeless[pair] = f"{solver} at {format_tolerance(tolerance)}: {wrong[0].text}"
            continue
        values = {name: own[name] for name in scales(own)}
        doubt = {name: float(np.abs(own[name] - other[name]).max()) for name in values}
        source = f"{solver} at {format_tolerance(tolerance)}"
        return Motion(values=values, doubt=doubt, scale=scales(own), source=source), own
    return None


def _tight(scene: Scene, solver: str, tolerance: float) -> Settings:
    return replace(
        scene.settings, solver=solver, tolerance=tolerance, absolute_tolerance=0.0, max_order=0, energy_check=True
    )


def reference(
    scene: Scene,
    steps: Sequence[Resolution],
    times: Array,
    finest: float,
    budget: Budget,
    requested: Sequence[str] = (),
    progress: Callable[[str], None] | None = None,
) -> Reference:
    """Return the reference for runs of a scene at these resolutions; ``requested`` are outputs, by default all.

    Raises
    ------
    UserError
        No accurate run ends in its time, or no output can be evaluated, or a requested one cannot.
    """
    units = {v.name: v.unit for v in scene.model.with_values(steps[-1]).compile().outputs}
    for name in requested:
        if name not in units:
            raise UserError(f"model {scene.model.name!r} has no output {name!r}{suggest(name, units)}")
    found: list[Motion | None] = []
    not_evaluated: dict[str, str] = {}
    hopeless: dict[Runs, str] = {}
    for step in steps:
        own = scene.changed(model=scene.model.with_values(step))
        compiled = own.model.compile()
        ran = tight(own, times, tight_runs(compiled, finest), budget, hopeless)
        if progress is not None:
            progress(f"reference {resolution_text(step)}".strip())
        if ran is None:
            found.append(None)
            continue
        motion, result = ran
        quiet, held = constant_outputs(result, compiled), driven_outputs(compiled)
        for name, doubt in motion.doubt.items():
            if name in held and doubt <= CONSTANT_OUTPUT_RATIO * motion.scale[name]:
                not_evaluated[name] = "driven"
            elif name in quiet:
                not_evaluated[name] = "does not move"
        found.append(_with_exact(own.model, times, motion))
    there = [(step, motion) for step, motion in zip(steps, found, strict=True) if motion]
    if not there:
        raise UserError(
            f"scene {scene.name!r} has no reference ({'; '.join(hopeless.values())}); shorten the run (stop_time), or "
            "give a larger budget"
        )
    motion, orders = converged(there)
    motion = _with_independent(scene.model.with_values(there[-1][0]), times, motion)
    for name in sorted(moving_places([list(known.values) for _, known in there])):
        not_evaluated[name] = "its position depends on the mesh"
    doubts = {name: doubt / motion.scale[name] for name, doubt in motion.doubt.items() if name not in not_evaluated}
    sharp = (
        min(MAX_OUTPUT_UNCERTAINTY, MAX_UNCERTAINTY_FACTOR * finest)
        if len(there) == 1 and not requested
        else MAX_OUTPUT_UNCERTAINTY
    )
    if not any(doubt <= sharp for doubt in doubts.values()):
        sharp = MAX_OUTPUT_UNCERTAINTY
    not_evaluated |= {name: f"uncertainty {doubt:.0e} of its range" for name, doubt in doubts.items() if doubt > sharp}
    evaluated = [name for name in doubts if name not in not_evaluated]
    return Reference(
        motion=motion,
        tight=found,
        units={name: units[name] for name in _select_outputs(scene.model, evaluated, not_evaluated, requested)},
        not_evaluated=not_evaluated,
        orders={name: order for name, order in orders.items() if name in evaluated},
    )


def _select_outputs(
    model: Model, evaluated: list[str], not_evaluated: dict[str, str], requested: Sequence[str]
) -> list[str]:
    for name in requested:
        if name not in evaluated:
            why = not_evaluated.get(name, "it is a residual, whose exact value is zero")
            raise UserError(f"output {name!r} of model {model.name!r} cannot be compared: {why}; {_allowed(evaluated)}")
    if not evaluated:
        reasons = "; ".join(f"{name}: {why}" for name, why in not_evaluated.items()) or "the model has no output"
        raise UserError(
            f"no output of model {model.name!r} distinguishes the runs ({reasons}); give it one that moves freely"
        )
    return list(requested) or evaluated


def _allowed(evaluated: Sequence[str]) -> str:
    return f"allowed: {', '.join(evaluated)}" if evaluated else "nor does any other"


def _with_exact(model: Model, times: Array, motion: Motion) -> Motion:
    """Put the exact motion in place of what is known of it."""
    exact = None if model.replaced_inputs else model.exact(times)  # it is that of the inputs at their start values
    if exact is None:
        return motion
    source = f"the exact motion for {', '.join(exact)}, else {motion.source}"
    values, doubt = motion.values | exact, motion.doubt | dict.fromkeys(exact, 0.0)
    return replace(motion, values=values, doubt=doubt, source=source)


def _with_independent(model: Model, times: Array, motion: Motion) -> Motion:
    """Replace the computed reference by that of another code or an experiment."""
    data = None if model.replaced_inputs else model.independent(times)
    if data is None:
        return motion
    values = motion.values | {name: values for name, (values, _) in data.items()}
    doubt = motion.doubt | {name: doubt for name, (_, doubt) in data.items()}
    source = f"independent data for {', '.join(data)}, else {motion.source}"
    return replace(motion, values=values, doubt=doubt, source=source)


def converged(found: Sequence[tuple[Resolution, Motion]]) -> tuple[Motion, dict[str, float]]:
    """Return the motion that resolutions lead to, coarse to fine, and the orders observed by output."""
    finest = found[-1][1]
    if len(found) == 1:
        return finest, {}
    values, doubt, orders = {}, {}, {}
    names = [name for name in finest.values if all(name in motion.values for _, motion in found)]
    sizes = [size(step) for step, _ in found]
    for name in names:
        values[name], own, order = limit([motion.values[name] for _, motion in found], sizes)
        doubt[name] = own + max(motion.doubt[name] for _, motion in found)
        if order is not None:
            orders[name] = order
    source = f"{'the limit' if orders else 'the finest'} of {len(found)} resolutions"
    return Motion(values=values, doubt=doubt, scale=finest.scale, source=source), orders
