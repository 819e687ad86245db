"""Whether a scene is hard, and why: from a run of it, watched, and from the eigenvalues about some of its states.

Scenes that cannot start or that fail are included: the findings contain the reason and the other results that are
available. Results are estimates unless marked as exact. The run uses the solver and the tolerance of the scene.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from math import isfinite, nan
from typing import Any

import numpy as np

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.mechanics.arrays.nonholonomic import position_rank
from mbfmu.mechanics.numbers import finite
from mbfmu.modeling.model import Model, as_model
from mbfmu.modeling.scene import Scene, default_scene
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation
from mbfmu.session.solver_selection import SolverChoice, State, select_solver
from mbfmu.session.stiffness import Spectrum, spectrum
from mbfmu.studies.check_report import format_findings, reasons
from mbfmu.studies.held_inputs import describe_held_inputs, not_examined
from mbfmu.studies.loops import Loop, loops, redundant_rows
from mbfmu.studies.nearest_singularity import Nearest, SingularityMonitor
from mbfmu.util.diagnostics import Diagnosed, Diagnostic
from mbfmu.util.errors import UserError, require_arguments
from solvers.options import Statistics

MAX_EXAMINED_STATES, MAX_EXAMINED_TREE_STATES = 200, 40  # states of a run that are looked at; of a large tree
EIGENVALUE_STATES = 5  # of them about which eigenvalues are taken
EIGENVALUE_NOISE = 1e-8  # of eigenvalues, and of the squares of those that are zero
DEFAULT_PATIENCE = 10.0  # s; a run that takes longer is left where it is


@dataclass(frozen=True, kw_only=True)
class Stiffness:
    """How fast what is fastest could move, against what does.

    Attributes
    ----------
    eigenvalue, t, coordinate
        Fastest eigenvalue over the states looked at, 1/s, when, s, and which coordinate takes most part in it.
    own
        Largest rate of the motion by its velocities, drives and gravity, 1/s.
    followed
        Rate of what swings by more than the tolerance, at most, 1/s.
    tolerance
        The absolute one, relative to the nominal value of each coordinate.
    states
        About how many states eigenvalues were taken.
    """

    eigenvalue: complex
    t: float
    coordinate: str
    own: float
    followed: float
    tolerance: float
    states: int

    @property
    def ratio(self) -> float:
        """The fastest eigenvalue over the rate of what must be followed; not a number where nothing moves."""
        return abs(self.eigenvalue) / self.followed if self.followed > 0.0 else nan


@dataclass(frozen=True, kw_only=True)
class Findings(Diagnosed):
    """Result of :func:`mbfmu.check`.

    Attributes
    ----------
    name, solver, tolerance
        Name of the scene, and solver and tolerance of the run; with ``auto`` the selected solver.
    stop_time, reached
        End time of the scene, and time up to which it was examined, s.
    coordinates, states, rows, freedom, position_freedom
        Numbers of free coordinates, of first-order states, of constraint equations (without trivially satisfied ones)
        and of degrees of freedom of velocities and of positions; the last two are None if the model did not start. They
        differ if constraints are nonholonomic.
    tree
        Whether it is a large model that is solved by recursions and not by dense matrices.
    loops
        One entry per cut joint: its ``name``, the ``bodies`` of the loop, its ``size`` (the largest distance
        between two joints of one of them, m), its number of ``rows``, those that are ``vanishing`` (trivially
        satisfied) and ``redundant``, and the largest ``gap`` it had, in units of its size or in rad.
    redundant, vanishing
        Names of redundant and of trivially satisfied constraint equations.
    nearest
        The nearest singular configuration: its time ``t`` (s), the ``ratio`` of the smallest singular value of
        the constraints to the largest, the ``loops`` it is in, the ``gap`` by which it is missed, in units of the rows
        (zero: it is passed; not a number: unknown), and ``passes``: the number of approaches. None without
        loops.
    stiffness
        Largest ``eigenvalue`` (1/s) of the examined states, its time ``t`` (s), the ``coordinate`` with the
        largest part in it, the rate ``own`` of the motion and that of the modes that must be ``followed`` (1/s) because
        their amplitude exceeds the absolute ``tolerance``, their ``ratio``, and the number of ``states``. None without
        degrees of freedom.
    limit
        What limited the step size: ``accuracy``, ``stability``, ``singular positions``, ``drives``,
        ``max_step``, or ``nothing`` if no step was taken.
    statistics
        Statistics of the solver; None if it did not start.
    outputs
        Number of output times of the scene in the examined time.
    diagnostics
        Notes, warnings and errors of the run, and notes on what was not examined.
    suits
        Recommended solver, and the reason.
    """

    name: str
    solver: str
    tolerance: float
    stop_time: float
    reached: float = 0.0
    coordinates: int = 0
    states: int = 0
    rows: int = 0
    freedom: int | None = None
    position_freedom: int | None = None
    tree: bool = False
    loops: tuple[Loop, ...] = ()
    redundant: tuple[str, ...] = ()
    vanishing: tuple[str, ...] = ()
    nearest: Nearest | None = None
    stiffness: Stiffness | None = None
    limit: str = "nothing"
    statistics: Statistics | None = None
    outputs: int = 0
    diagnostics: tuple[Diagnostic, ...] = ()
    suits: SolverChoice | None = None

    @property
    def hard(self) -> tuple[str, ...]:
        """Reasons why the scene is numerically difficult, a few words each; empty if it is not."""
        return reasons(self)

    def as_dict(self) -> dict[str, Any]:
        """Return all results as a dictionary for JSON; NaN is None."""
        found = asdict(self) | {"hard": list(self.hard)}
        found["suits"] = self.suits._asdict() if self.suits else None
        if self.stiffness is not None:
            value = self.stiffness.eigenvalue
            found["stiffness"] |= {"eigenvalue": [value.real, value.imag], "ratio": self.stiffness.ratio}
        return dict(_for_json(found))

    def as_text(self) -> str:
        """Return the report as text."""
        return format_findings(self)


def _for_json(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _for_json(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_for_json(v) for v in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def check(
    subject: Scene | Model | Mechanism,
    stop_time: float | None = None,
    patience: float = DEFAULT_PATIENCE,
    **settings: Any,
) -> Findings:
    """Check whether a scene, a model or a mechanism is numerically difficult, and why.

    Parameters
    ----------
    subject
        Scene, model or mechanism.
    stop_time
        End of the run, s; by default that of the scene or the model.
    patience
        Time limit of the run, s; later parts of the motion are not examined.
    **settings
        Settings that differ from the scene, such as ``solver``; see :class:`~mbfmu.modeling.settings.Settings`.

    Returns
    -------
    Findings
        Loops, redundant constraints, singular configurations, stiffness, what limits the step size, and a recommended
        solver.

    Raises
    ------
    UserError
        The arguments are invalid. A scene that cannot start, or fails, does not raise: ``failure`` contains the reason.
    """
    scene = subject if isinstance(subject, Scene) else default_scene(as_model(subject))
    require_arguments(Settings, settings)
    scene = scene.changed(**settings, stop_time=stop_time)
    if not finite("patience", patience) > 0.0:
        raise UserError(f"patience is {patience!r} s; allowed: greater than zero")
    found = Findings(
        name=scene.name, solver=scene.settings.solver, tolerance=scene.settings.tolerance, stop_time=scene.stop_time
    )
    try:
        compiled = scene.model.compile()
    except UserError as error:
        return _not_started(found, error, "everything, because the mechanism cannot be built")
    found = _of_plant(found, compiled)
    try:
        simulation = Simulation(scene.model, scene.settings)
    except UserError as error:
        found = replace(found, loops=loops(compiled, (), np.full(compiled.system.m, nan)))
        return _not_started(
            found, error, "singular configurations, stiffness and steps, because the run does not start"
        )
    return ExaminedRun(scene, compiled, simulation, patience).findings(found)


def _not_started(found: Findings, error: UserError, unseen: str) -> Findings:
    return replace(found, diagnostics=(error.diagnostic, not_examined(unseen)))


def _of_plant(found: Findings, compiled: CompiledMechanism) -> Findings:
    s = compiled.system
    vanishing = tuple(compiled.vanishing_rows)
    size = {"coordinates": s.n_velocities, "states": s.n_states, "rows": s.m}
    return replace(found, **size, tree=not s.has_matrices, vanishing=vanishing)


class ExaminedRun:
    """One run of a scene, looked at."""

    def __init__(self, scene: Scene, compiled: CompiledMechanism, simulation: Simulation, patience: float) -> None:
        self.scene, self.compiled, self.simulation, self.patience = scene, compiled, simulation, patience
        self.unseen: list[Diagnostic] = []
        self.gaps = np.zeros(compiled.system.m)
        self.longest = compiled.system.input_step_limit(0.0)[0]
        self.states: list[State] = []

    def findings(self, found: Findings) -> Findings:
        """Return the report."""
        s, run = self.compiled.system, self.simulation
        redundant = redundant_rows(self.compiled, run.t, run.stepper.q) if s.m else ()
        rank = s.m - len(redundant)
        watch = SingularityMonitor(self.compiled, rank, run) if rank else None
        freedom = run.stepper.freedom if s.has_matrices else s.n - rank
        bound = position_rank(s, run.t, run.stepper.q) if len(s.nonholonomic) else rank
        self._run(watch)
        reached, statistics, diagnostics = run.t, run.statistics, run.diagnostics
        self._note_unseen(reached)
        options, some = self.scene.settings.options(self.scene.stop_time), self._selected_states()
        return replace(
            found,
            solver=run.solver_choice.solver,
            reached=reached,
            freedom=freedom,
            position_freedom=s.n_velocities - bound if len(s.nonholonomic) else freedom,
            loops=loops(self.compiled, redundant, self.gaps),
            redundant=redundant,
            nearest=watch.nearest(run) if watch else None,
            stiffness=stiffness(self._spectra(some), options.absolute),
            limit=self._limit(statistics, reached),
            statistics=statistics,
            outputs=int(reached / self.scene.output_interval),
            suits=select_solver(self.compiled, some, options),
            diagnostics=(*diagnostics, *self.unseen),
        )

    def _run(self, watch: SingularityMonitor | None) -> None:
        """Run, and look at what there is to see between steps."""
        run, begin = self.simulation, time.perf_counter()
        count = MAX_EXAMINED_STATES if self.compiled.system.has_matrices else MAX_EXAMINED_TREE_STATES
        for t in np.linspace(run.t, self.scene.stop_time, count + 1):
            run.advance(float(t))
            self._record(watch)
            if run.failed or time.perf_counter() - begin > self.patience:
                break

    def _record(self, watch: SingularityMonitor | None) -> None:
        run = self.simulation
        q, v = run.stepper.q, run.stepper.v
        self.states.append((run.t, q, v))
        self.longest = min(self.longest, self.compiled.system.input_step_limit(run.t)[0])
        if self.compiled.system.m:
            terms = self.compiled.system.allocate_terms()
            self.compiled.system.fill_position(run.t, q, terms)
            self.gaps = np.maximum(self.gaps, np.abs(terms.Phi))
        if watch is not None:
            watch.record(run)

    def _selected_states(self) -> list[State]:
        """Return states from all over the run."""
        return [self.states[k] for k in np.unique(np.linspace(0, len(self.states) - 1, EIGENVALUE_STATES).astype(int))]

    def _spectra(self, states: list[State]) -> list[Spectrum]:
        found, why = [], ""
        for state in states:
            try:
                found.append(spectrum(self.compiled, *state))
            except UserError as error:
                why = error.diagnostic.message
        if why:
            what = f"eigenvalues at {len(states) - len(found)} of {len(states)} states: {why}"
            self.unseen.append(not_examined(what))
        return found

    def _limit(self, statistics: Statistics, reached: float) -> str:
        """Return what set the length of most steps."""
        if not statistics.steps:
            return "nothing"
        mean = reached / statistics.steps
        if 2 * statistics.stability_limited > statistics.steps:
            return "stability"
        if 5 * statistics.refused > statistics.steps or statistics.coarser > 1.0:
            return "singular configurations"
        if self.scene.settings.max_step and mean > 0.5 * self.scene.settings.max_step:
            return "max_step"
        return "drives" if mean > 0.5 * self.longest else "accuracy"

    def _note_unseen(self, reached: float) -> None:
        """Note what the run has not shown."""
        s = self.compiled.system
        if reached < self.scene.stop_time and not self.simulation.failed:
            what = f"the motion after t = {reached:g} s, because the run takes longer than {self.patience:g} s"
            self.unseen.append(not_examined(what))
        self.unseen += describe_held_inputs(self.compiled.inputs.variables)
        if not s.has_matrices:
            self.unseen.append(not_examined("eigenvalues other than the largest (large model)"))
            if s.m:
                self.unseen.append(not_examined("the distance from singular configurations (large model)"))


def stiffness(found: list[Spectrum], tolerance: float) -> Stiffness | None:
    """Return how fast what is fastest could move over these states; None where nothing is free or known."""
    if not any(len(f.values) for f in found):
        return None
    fastest = max(found, key=lambda f: abs(f.fastest))
    return Stiffness(
        eigenvalue=without_noise(fastest.fastest, fastest.own),
        t=fastest.t,
        coordinate=fastest.leading,
        own=max(f.own for f in found),
        followed=max(f.followed(tolerance) for f in found),
        tolerance=tolerance,
        states=len(found),
    )


def without_noise(value: complex, own: float) -> complex:
    """Return an eigenvalue with rounding errors, relative to the rate ``own`` of the motion, 1/s, set to zero.

    Differences have errors in squares of rates: a double eigenvalue of zero results as the root of that.
    """
    if abs(value) ** 2 <= EIGENVALUE_NOISE * own**2:
        return 0j
    return complex(*(part if abs(part) > EIGENVALUE_NOISE * abs(value) else 0.0 for part in (value.real, value.imag)))
