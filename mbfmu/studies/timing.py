"""Times that can be compared on a busy machine, and a limit to what runs may take.

CPU time does not count what other processes take. BLAS is held to one thread: threads that wait for each other spin,
which would count as work. Several runs are timed in turn, a round of all of them after another, so that what disturbs
the machine disturbs all alike.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import Mechanism
from mbfmu.modeling.model import Model
from mbfmu.modeling.parameters import MAX_INTEGER
from mbfmu.modeling.scene import Scene
from mbfmu.modeling.settings import Settings
from mbfmu.session.result import Result
from mbfmu.session.run import run
from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import UserError
from solvers.linalg.threads import one_thread


@dataclass(frozen=True)
class CpuTimes:
    """CPU times of the runs of one thing, s."""

    times: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median, s."""
        return float(np.median(self.times))

    @property
    def spread(self) -> float:
        """Distance of the quartiles over the median."""
        low, high = np.quantile(self.times, (0.25, 0.75))
        return float((high - low) / self.median) if self.median else 0.0


class BudgetExceeded(Exception):
    """A run took longer than it was given."""


@dataclass
class Budget:
    """CPU time for many runs, s; what is compiled first does not count."""

    seconds: float
    spent: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        if not isinstance(self.seconds, int | float) or not self.seconds > 0.0:
            raise UserError(f"budget is {self.seconds!r} s; allowed: a number of seconds greater than zero")

    @property
    def left(self) -> float:
        """What is left of it, s."""
        return max(0.0, self.seconds - self.spent)

    def run(
        self, model: Model | Mechanism, settings: Settings, times: NDArray[np.float64], most: float
    ) -> tuple[Result, float]:
        """Return a run's outputs at ``times`` and what it took, s.

        Raises
        ------
        BudgetExceeded
            It has taken ``most`` s, or what is left.
        UserError
            It cannot begin.
        """
        begin, most = 0.0, min(most, self.left)

        def watch(_: Simulation) -> None:
            nonlocal begin
            begin = begin or time.process_time()
            if time.process_time() - begin > most:
                raise BudgetExceeded

        try:
            with one_thread():
                result = run(model, settings, times, watch=watch)
        finally:
            taken = time.process_time() - begin if begin else 0.0
            self.spent += taken
        return result, taken

    def time(self, scene: Scene) -> float:
        """Return the CPU time of a scene's integration alone, s: no outputs on the way, all started before."""
        intervals = int(np.ceil(scene.stop_time / scene.output_interval))
        most = min(MAX_INTEGER, scene.settings.max_steps * intervals)
        simulation = Simulation(scene.model, replace(scene.settings, max_steps=most))
        taken = cpu_time(lambda: simulation.advance(scene.stop_time))
        self.spent += taken
        return taken


def cpu_time(function: Callable[[], object]) -> float:
    """Return the CPU time of a call, s."""
    with one_thread():
        begin = time.process_time()
        function()
        return time.process_time() - begin


def time_interleaved(
    functions: Sequence[Callable[[], float]],
    rounds: int,
    *,
    expected: Sequence[float] = (),
    left: Callable[[], float] = lambda: inf,
    progress: Callable[[str], None] | None = None,
) -> list[CpuTimes]:
    """Return the times that functions give, round by round.

    The first round has all of them; of a later one those are left out, dear ones first, that are ``expected`` (s) to
    take more than is ``left``.
    """
    times: list[list[float]] = [[] for _ in functions]
    price = expected or [0.0] * len(functions)
    for number in range(rounds):
        for i in sorted(range(len(functions)), key=lambda i: price[i]):
            if not number or price[i] < left():
                times[i].append(functions[i]())
            if progress is not None:
                progress("timed")
    return [CpuTimes(tuple(own)) for own in times]


def check_repeats(repeats: int) -> None:
    """Refuse what is no number of rounds."""
    if isinstance(repeats, bool) or not isinstance(repeats, int) or repeats < 1:
        raise UserError(f"repeats is {repeats!r}; allowed: a whole number from 1 on")
