"""Options of a run, and its statistics."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from solvers.compiled.kernel import records
from solvers.compiled.record import Record, f8, i8


class OptionsRecord(Record):
    """Options of a solver, as compiled loops read them."""

    rtol: f8
    absolute: f8
    max_step: f8
    max_order: i8
    max_steps: i8
    energy_check: i8
    duration: f8


OPTIONS = OptionsRecord.dtype


@dataclass(frozen=True, kw_only=True)
class Switching:
    """Criteria of 'hybrid' for switching between LU and projection."""

    flicker_steps: int = 20  # changes of the independents within fewer steps count as flicker
    flicker_count: int = 3  # number of such changes after which LU is left
    energy_jump: float = 0.01  # of the largest kinetic energy so far, in one step
    collapse_cuts: int = 6  # cuts of one step that leave LU
    calm_steps: int = 5  # consecutive steps not shrinking and with one choice of independents to return to LU

    def __post_init__(self) -> None:
        """Refuse numbers that are not positive."""
        for name in ("flicker_steps", "energy_jump", "flicker_count", "collapse_cuts", "calm_steps"):
            require(name, getattr(self, name), 0.0, math.inf)


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of all solvers; a solver ignores those that it does not use."""

    rtol: float = 1e-6  # relative tolerance of positions and velocities
    atol: float | None = None  # absolute tolerance, in units of each coordinate; None: rtol
    max_step: float = math.inf  # s
    max_order: int | None = None  # None: the solver's own, see solvers.steppers.ORDER_LIMITS
    max_steps: int = 100_000  # in one call of advance
    energy_check: bool = True  # account work and the bound of the energy error
    duration: float = 10.0  # s, for which the run is to go on: the scale of time of a start at rest
    switching: Switching = field(default_factory=Switching)

    def __post_init__(self) -> None:
        """Refuse what no solver can honor."""
        if not 1e-12 <= self.rtol <= 1e-2:
            raise ValueError(f"rtol is {self.rtol}; allowed: 1e-12 to 1e-2")
        require("atol", self.absolute, 0.0, math.inf)
        if not self.max_step > 0.0:
            raise ValueError(f"max_step is {self.max_step} s; allowed: greater than zero")
        require("duration", self.duration, 0.0, math.inf)
        require("max_steps", self.max_steps, 0.0, math.inf)
        if self.max_order is not None and not 1 <= self.max_order <= 12:
            raise ValueError(f"max_order is {self.max_order}; allowed: 1 to 12")

    @property
    def absolute(self) -> float:
        """Absolute tolerance that is used."""
        return self.rtol if self.atol is None else self.atol

    def record(self) -> NDArray[Any]:
        """Return the options as a record for kernels; an order of 0 is the highest of a solver."""
        found = records(1, OPTIONS)
        found["rtol"], found["absolute"], found["energy_check"] = self.rtol, self.absolute, self.energy_check
        found["max_step"], found["max_steps"] = self.max_step, self.max_steps
        found["max_order"], found["duration"] = self.max_order or 0, self.duration
        return found


@dataclass(frozen=True, kw_only=True)
class Statistics:
    """Counters of a run since construction; included in save and restore."""

    steps: int = 0
    rejected: int = 0
    rhs_evals: int = 0  # evaluations of y' (Adams) or of the residual (IDA)
    restarts: int = 0  # begins of a history after the first
    order: int = 0  # of the last step
    step_size: float = 0.0  # s, of the last step
    refused: int = 0  # of the rejected: steps that might have jumped to another branch
    coarser: float = 1.0  # largest tolerance near near misses in units of the requested one, see Stepper.diagnostics
    rate_growth: float = 0.0  # largest growth of errors of rates, see solvers.inertia; 0: not known
    rate_growth_at: float = 0.0  # s, when
    stability_limited: int = 0  # of an explicit solver: steps whose length stability set, and not accuracy
    partition_switches: int = 0  # between LU and projection
    choices: int = 0  # changes of the independent coordinates under LU
    left_by_turn: int = 0  # the branch turned, or a singular configuration was close ahead
    left_by_flicker: int = 0
    left_by_energy: int = 0
    left_by_collapse: int = 0
    time_lu: float = 0.0  # s of motion
    time_projection: float = 0.0  # s of motion


def require(name: str, value: float, above: float, below: float) -> None:
    """Raise unless ``value`` lies strictly between the bounds."""
    if not above < value < below:
        raise ValueError(f"{name} is {value}; allowed: between {above} and {below}, bounds excluded")
