"""What accuracy costs in time: every solver at several tolerances against the exact motion."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import UserError
from mbfmu.mechanics import Mechanism
from mbfmu.model import Model, of_user
from mbfmu.native import communication_points, run
from mbfmu.result import Result
from mbfmu.scene import Scene, default_scene
from mbfmu.settings import Settings
from mbfmu.simulation import Simulation
from mbfmu.table import table
from solvers import SOLVERS

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
BRANCH_TOLERANCE = 0.05  # rad; twice the error that the loosest tolerance leaves on the right branch
REFERENCE_TOLERANCE = 1e-12


@dataclass(frozen=True, kw_only=True)
class Row:
    """One solver at one tolerance.

    Attributes
    ----------
    study
        ``motion``; rows of :mod:`mbfmu.studies.settling` say ``settling``.
    wall_s
        Median time of the integration alone, without compilation, start and outputs, s.
    steps
        None where the solver does not tell (SUNDIALS' binding does not).
    max_error
        Largest error of an angle against the exact motion up to the last good time, rad; None where none is known.
    energy_imbalance
        Largest difference between the energy and what work has made of it, J.
    position_residual, velocity_residual
        Largest at the outputs, m and m/s.
    branch_jump
        Whether the motion left its branch.
    end_time
        Last good time, s.
    warning
        When and how the energy balance was lost; empty: it held.
    """

    solver: str
    rtol: float
    wall_s: float
    steps: int | None
    rhs_evals: int
    max_error: float | None
    energy_imbalance: float
    position_residual: float
    velocity_residual: float
    partition_switches: int
    branch_jump: bool
    end_time: float
    status: str
    warning: str = ""
    study: str = "motion"

    def as_dict(self) -> dict[str, Any]:
        """Return the row for JSON."""
        return asdict(self)


Reference = dict[str, NDArray[np.float64]]
History = tuple[NDArray[np.float64], NDArray[np.float64]]


def reference_motion(model: Model, times: NDArray[np.float64]) -> Reference:
    """Return the exact motion where the model knows it, else that of ``adams`` at a tight tolerance."""
    exact = model.exact(times)
    if exact is not None:
        return exact
    result = run(model, Settings(solver="adams", tolerance=REFERENCE_TOLERANCE), times)
    if result.failure:
        return {}
    return {v.name: result[v.name] for v in result.variables if v.unit == "rad"}


def compare(
    subject: Scene | Model | Mechanism,
    *,
    solvers: Sequence[str] = tuple(SOLVERS),
    tolerances: Sequence[float] = TOLERANCES,
    repeats: int = 5,
    progress: Callable[[str], None] | None = None,
) -> tuple[list[Row], dict[str, History]]:
    """Run every solver at every tolerance: a scene, or a model for its own time.

    Returns
    -------
    rows
        One a run, in the order of solvers and tolerances.
    energies
        Times and energy imbalance of each solver at the tolerance nearest the scene's.

    Raises
    ------
    UserError
        The model is a large tree.
    """
    scene = subject if isinstance(subject, Scene) else default_scene(of_user(subject))
    _refuse_large_tree(scene.model)
    times = communication_points(scene.stop_time, scene.output_interval)
    reference = reference_motion(scene.model, times)
    shown = min(tolerances, key=lambda tol: abs(np.log(tol / scene.settings.tolerance)))
    rows: list[Row] = []
    energies: dict[str, History] = {}
    for solver in solvers:
        for tolerance in tolerances:
            settings = Settings(solver=solver, tolerance=tolerance, max_step=scene.settings.max_step)
            result = run(scene.model, settings, times)
            wall = statistics.median(time_alone(scene, settings) for _ in range(repeats))
            rows.append(judge(scene.model, solver, tolerance, wall, result, reference))
            if tolerance == shown:
                energies[solver] = (result.t, result["energy_imbalance"])
            if progress is not None:
                progress(f"{solver} {tolerance:.0e}")
    return rows, energies


def _refuse_large_tree(model: Model) -> None:
    """Without loops nothing is partitioned, and what is stiff takes explicit steps that no tolerance lengthens."""
    system = model.plant().system
    if not system.has_matrices and not system.m:
        raise UserError(
            f"model {model.name!r} is a tree of {system.n} coordinates without loops: there hybrid and adams-lu do "
            "what adams does, whose steps stability bounds at every tolerance; "
            f"compare runs of yours (mbfmu run {model.name} --native --solver ida --tolerance 1e-4)"
        )


def time_alone(scene: Scene, settings: Settings) -> float:
    """Return the time of the integration alone, s: no outputs on the way, everything compiled and started before."""
    simulation = Simulation(scene.model, settings)
    begin = time.perf_counter()
    simulation.advance(scene.stop_time)
    return time.perf_counter() - begin


def judge(model: Model, solver: str, rtol: float, wall: float, result: Result, reference: Reference) -> Row:
    """Measure one result."""
    outputs = result.as_dict()
    count = len(result.t)
    errors = [np.abs(outputs[name] - exact[:count]).max() for name, exact in reference.items()]
    gap = model.branch_gap(outputs)
    return Row(
        solver=solver,
        rtol=rtol,
        wall_s=wall,
        steps=result.statistics.steps or None,
        rhs_evals=result.statistics.rhs_evals,
        max_error=float(max(errors)) if errors else None,
        energy_imbalance=float(np.abs(outputs["energy_imbalance"]).max()),
        position_residual=largest(outputs, "position_residual"),
        velocity_residual=largest(outputs, "velocity_residual"),
        partition_switches=result.statistics.partition_switches,
        branch_jump=bool(gap is not None and gap.max() > BRANCH_TOLERANCE),
        end_time=float(result.t[-1]),
        status=result.failure or "ok",
        warning=result.verdict,
    )


def largest(outputs: dict[str, NDArray[np.float64]], name: str) -> float:
    """Return the largest value of an output; zero where the model does not have it."""
    return float(outputs[name].max()) if name in outputs else 0.0


def as_text(rows: Sequence[Row]) -> str:
    """Return the rows as a table for people."""
    header = ("solver", "rtol", "time [ms]", "steps", "evals", "error [rad]", "imbalance [J]", "switches", "outcome")
    lines = [
        (
            row.solver,
            f"{row.rtol:.0e}",
            f"{1e3 * row.wall_s:.2f}",
            "-" if row.steps is None else str(row.steps),
            str(row.rhs_evals),
            "-" if row.max_error is None else f"{row.max_error:.1e}",
            f"{row.energy_imbalance:.1e}",
            str(row.partition_switches),
            outcome(row),
        )
        for row in rows
    ]
    return table(header, lines)


def outcome(row: Row) -> str:
    """Say in a few words how a run ended."""
    jump = "left its branch" if row.branch_jump else ""
    lost = "inaccurate" if row.warning else ""
    stop = "" if row.status == "ok" else f"stopped: {row.status.partition('. ')[0]}"
    return "; ".join(filter(None, (lost, jump, stop))) or "ok"
