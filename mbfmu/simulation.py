"""A model at work: one object behind the native run and inside the FMU."""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbfmu.equilibrium import Balance
from mbfmu.errors import UserError
from mbfmu.mechanics import Variable
from mbfmu.mechanics.bending import COARSE, FOLDED
from mbfmu.model import Model, suggest
from solvers import SOLVERS, Options, SolverError, Statistics, Status, stepper
from solvers.stepper import Samples

Array = NDArray[np.float64]

_compiled: set[tuple[type, bool]] = set()  # kinds of runs whose kernels this process has compiled

UNFOLD = (
    "Let it move more slowly, damp it, or make it stiffer; where the motion is meant, only a finer grid follows it."
)
ROWS = 100  # outputs recorded between two reports of progress

PARTITIONS = {"projection": "adams", "lu": "adams-lu", "hybrid": "hybrid"}


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How a model is integrated.

    Parameters
    ----------
    solver
        ``ida``, ``adams``, ``hybrid`` or ``adams-lu``.
    partition
        Of ``adams``: ``projection``, ``lu`` (the same as solver ``adams-lu``) or ``hybrid``.
    tolerance
        Relative tolerance; the absolute one is the same in SI units.
    max_step
        Largest step, s; 0: no limit.
    start_at_equilibrium
        Start in the steady state next to the given start, at rest but for the drives.
    """

    solver: str = "ida"
    partition: str = "projection"
    tolerance: float = 1e-6
    max_step: float = 0.0
    start_at_equilibrium: bool = False

    def __post_init__(self) -> None:
        """Check the names and numbers; raises UserError."""
        if self.solver not in SOLVERS:
            raise UserError(f"solver is {self.solver!r}{suggest(self.solver, SOLVERS)}")
        if self.partition not in PARTITIONS:
            raise UserError(f"partition is {self.partition!r}{suggest(self.partition, PARTITIONS)}")
        try:
            self.options()
        except (ValueError, TypeError) as error:
            raise UserError(str(error)) from error

    @property
    def name(self) -> str:
        """The solver's name with its partition resolved."""
        return PARTITIONS[self.partition] if self.solver == "adams" else self.solver

    def options(self) -> Options:
        """Return what the stepper takes."""
        return Options(rtol=self.tolerance, max_step=self.max_step or inf)


class Simulation:
    """A model started at ``t0``: advance it, read its outputs, change inputs and tunable parameters between steps.

    Parameters
    ----------
    inputs
        Values of inputs by number that differ from their start.

    Raises
    ------
    UserError
        The model cannot be built, assembled or balanced with these parameters.
    """

    def __init__(
        self, model: Model, settings: Settings, t0: float = 0.0, inputs: Mapping[int, float] | None = None
    ) -> None:
        self.model = model
        self.settings = settings
        self.plant = model.build().compile()
        for index, value in (inputs or {}).items():
            self.plant.set_input(index, value, t0)
        if settings.start_at_equilibrium:
            found = Balance(model, self.plant).solve()
            q, v = found.q, found.v
        else:
            q, v = self.plant.assemble(t0)
        try:
            self.stepper = stepper(settings.name, self.plant.system, t0, q, v, settings.options())
        except ValueError as error:
            raise UserError(f"model {model.name!r}: {error}") from error
        self._out = np.zeros(len(self.plant.outputs))
        self._folded = ""
        self._bend, self._bent_at = self.plant.bend(t0, q), t0  # the sharpest so far
        self._compile(t0, q, v)

    def _compile(self, t0: float, q: Array, v: Array) -> None:
        """Have every kernel compiled (or loaded) now, by a stepper thrown away, and not in the first step of a run.

        Kernels differ with the solver, with dense or large systems, and with constraints.
        """
        kind = (type(self.stepper), self.plant.system.m > 0)
        if kind in _compiled:
            return
        rehearsal = stepper(self.settings.name, self.plant.system, t0, q, v, self.settings.options())
        self.outputs()
        times, values = np.array([t0 + 1e-3]), np.zeros((1, len(self._out)))
        samples = rehearsal.sample(times)
        done = len(samples.q)
        self.plant.observe_all(times[:done], *samples, values[:done])
        if done and rehearsal.advance(t0 + 2e-3).ok:
            _compiled.add(kind)

    @property
    def t(self) -> float:
        """Time reached, s."""
        return float(self.stepper.t)

    @property
    def statistics(self) -> Statistics:
        """What the solver has done so far."""
        return self.stepper.statistics

    @property
    def failure(self) -> str:
        """Why the last :meth:`advance` or :meth:`record` ended early and what to try; empty: it did not."""
        status = self.stepper.status
        return self._folded if status.ok else f"{status.message}. {status.remedy_after(self.settings.name)}"

    @property
    def warning(self) -> str:
        """Why the motion so far is not to be trusted; empty: nothing speaks against it."""
        if self._bend is None or self._bend.largest <= COARSE:
            return ""
        return f"{self._bend} (t = {self._bent_at:.9g} s)"

    def advance(self, t: float) -> Status:
        """Advance to t (s); on failure the last good state stays. :attr:`failure` also tells of a folded sheet."""
        status = self.stepper.advance(t)
        self._look(self.t, self.stepper.q)
        return status

    def _look(self, t: float, q: Array) -> bool:
        """Note how sharply plates bend at positions q (nq,); False where a cell is folded, which ends a run."""
        here = self.plant.bend(t, q)
        if here is None or self._bend is None:
            return True
        if here.largest > self._bend.largest:
            self._bend, self._bent_at = here, t
        self._folded = f"A cell is folded: {self.warning}. {UNFOLD}" if here.largest > FOLDED else ""
        return not self._folded

    def outputs(self) -> Array:
        """Return the outputs at the time reached, in the plant's order; the array is used again.

        Raises UserError where the accelerations are not determined.
        """
        stepper = self.stepper
        try:
            a, lam = stepper.accelerations()  # the limit along the motion in a singular position
        except SolverError as error:
            raise UserError(f"model {self.model.name!r}: {error}") from error
        self.plant.observe(stepper.t, stepper.q, stepper.v, a, lam, self._out)
        return self._out

    def record(self, times: Array, values: Array) -> int:
        """Advance to each of ``times`` (k,) and put the outputs into a row of ``values`` (k, outputs) each.

        Returns the number of rows; where it is less than k :attr:`failure` says why.
        """
        times = np.ascontiguousarray(times)
        samples = self.stepper.sample(times)
        done = len(samples.q)
        for i in range(done):
            if not self._look(times[i], samples.q[i]):
                done = i
                break
        self.plant.observe_all(times[:done], *Samples(*(rows[:done] for rows in samples)), values[:done])
        return done

    def set_input(self, index: int, value: float) -> None:
        """Let an input hold from now on."""
        self.plant.set_input(index, value, self.t)
        self.stepper.restart()

    def retune(self, model: Model) -> None:
        """Go on with other values of the tunable parameters.

        Raises
        ------
        UserError
            A parameter that is not tunable differs, or the structure would change.
        """
        for declared in model.parameters():
            before, after = getattr(self.model, declared.name), getattr(model, declared.name)
            if before != after and not declared.tunable:
                raise UserError(f"parameter {declared.name!r} is not tunable; it cannot change during a run")
        self.plant.adopt(model.build().compile())
        self.model = model
        self.stepper.restart()

    def save(self) -> bytes:
        """Return the whole state: solver, inputs and tunable parameters."""
        changed = {p.name: getattr(self.model, p.name) for p in self.model.parameters() if p.tunable}
        head = json.dumps({"parameters": changed, "inputs": self.plant.input_state()}).encode()
        return len(head).to_bytes(8, "little") + head + self.stepper.save()

    def restore(self, state: bytes) -> None:
        """Take up a state saved by a simulation of the same model and settings."""
        split = 8 + int.from_bytes(state[:8], "little")
        head = json.loads(state[8:split])
        model = self.model.with_values(head["parameters"])
        if model != self.model:
            self.plant.adopt(model.build().compile())
            self.model = model
        self.plant.restore_inputs(head["inputs"])
        self.stepper.restore(state[split:])


@dataclass
class Result:
    """Outputs over time, and how the run went."""

    times: Array  # (k,) s
    values: Array  # (k, outputs)
    variables: tuple[Variable, ...]
    statistics: Statistics
    wall_time: float  # s, between the first and the last output
    failure: str = ""  # why the run ended early and what to try; empty: it did not
    warning: str = ""  # why it is not to be trusted though it ran; empty: nothing speaks against it

    def __getitem__(self, name: str) -> Array:
        """Return one output over time."""
        names = [v.name for v in self.variables]
        if name not in names:
            raise UserError(f"no output {name!r}{suggest(name, names)}")
        return self.values[:, names.index(name)]

    def as_dict(self) -> dict[str, Array]:
        """Return every output over time, by name."""
        return {v.name: self.values[:, i] for i, v in enumerate(self.variables)}

    def write_csv(self, path: Path) -> None:
        """Write time and outputs; the header names each with its unit."""
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["time [s]", *(f"{v.name} [{v.unit}]" for v in self.variables)])
            for t, row in zip(self.times, self.values, strict=True):
                writer.writerow([repr(float(t)), *(repr(float(x)) for x in row)])


def communication_points(stop_time: float, interval: float) -> Array:
    """Return 0, interval, 2 interval, ... and the stop time."""
    count = int(np.ceil(stop_time / interval - 1e-9))
    times: Array = np.minimum(interval * np.arange(count + 1), stop_time)
    return times


def run(
    model: Model,
    settings: Settings,
    times: Array,
    progress: Callable[[float], None] | None = None,
    watch: Callable[[Simulation], None] | None = None,
) -> Result:
    """Run a model natively, without an FMU, and record its outputs at ``times``; stops at a failure.

    ``watch`` is shown the simulation whenever its outputs have been read: its bodies are in place then.
    """
    simulation = Simulation(model, settings, float(times[0]))
    values = np.zeros((len(times), len(simulation.plant.outputs)))
    values[0] = simulation.outputs()
    if watch is not None:
        watch(simulation)
    begin, done, failure = time.perf_counter(), 1, ""
    while done < len(times) and not failure:
        rows = slice(done, done + (ROWS if watch is None else 1))
        done += simulation.record(times[rows], values[rows])
        failure = simulation.failure
        if failure:
            break
        if watch is not None:
            watch(simulation)
        if progress is not None:
            progress(float(times[done - 1]))
    wall = time.perf_counter() - begin
    warning = "" if failure else simulation.warning
    return Result(times[:done], values[:done], simulation.plant.outputs, simulation.statistics, wall, failure, warning)
