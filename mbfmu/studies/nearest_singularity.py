"""The nearest singular configuration of a motion: time, distance, loops, and whether it is passed.

The distance is measured by singular values of the constraints, as in messages
(:func:`mbfmu.session.energy_check.distance`): the smallest divided by the largest. It is zero in a singular
configuration and decreases linearly to it, so its minimum between two samples is found by golden section, on the run
itself, taken up again at the sample before.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nan

import numpy as np
import scipy

from mbfmu.mechanics import CompiledMechanism
from mbfmu.session.energy_check import NEAR_SINGULAR_RATIO, distance, loops_of
from mbfmu.session.simulation import Simulation
from solvers.options import Options
from solvers.steppers.dense import DenseFormulation
from solvers.system import System

REFINED_RATIO_LIMIT = 0.3  # ratio between samples from which on its minimum is looked for
MAX_REFINED_MINIMA = 20  # minima that are looked for
RATIO_NOISE = 1e-4  # part of a ratio by which another one must be less
MINIMUM_TIME_TOLERANCE = 1e-7  # of the time between samples, to which a minimum is looked for
# times the smallest ratio another one is as near, and below this they are all nothing
EQUAL_RATIO_FACTOR, ZERO_RATIO = 3.0, 1e-5


@dataclass(frozen=True, kw_only=True)
class Nearest:
    """The nearest singular configuration of a motion.

    Attributes
    ----------
    t
        When, s; where several are as near the first of them.
    ratio
        Smallest singular value of the constraints over the largest there, in [0, 1].
    loops
        Names of the cut joints and couplings whose rows take most part.
    gap
        By how much the loop misses the singular one, in units of its rows: zero where it goes through, infinite where
        motions of several degrees of freedom pass next to it, not a number if none was found or none was searched.
    passes
        How often the motion comes near enough for a message to call it so.
    """

    t: float
    ratio: float
    loops: tuple[str, ...]
    gap: float
    passes: int


class SingularityMonitor:
    """Measures the distance of singular configurations along a run.

    Parameters
    ----------
    compiled
        One of the same model, that is not the run's.
    rank
        Constraint equations that do not depend on others.
    simulation
        The run, where it starts.
    """

    def __init__(self, compiled: CompiledMechanism, rank: int, simulation: Simulation) -> None:
        self._compiled_mechanism, self._rank = compiled, rank
        start = simulation.t, simulation.stepper.q, simulation.stepper.v
        rtol = max(Options().rtol, simulation.settings.tolerance)  # accepts what the run accepts
        coarse = Options(rtol=rtol, duration=simulation.stepper.options.duration)
        system = compiled.system
        self._formulation = DenseFormulation(system, *start, coarse) if isinstance(system, System) else None
        self._times: list[float] = []
        self._ratios: list[float] = []
        self._states: list[bytes] = []

    def record(self, simulation: Simulation) -> None:
        """Note how near it is where the run stands."""
        if self._times and not simulation.t > self._times[-1]:
            return
        self._times.append(simulation.t)
        self._ratios.append(self._ratio(simulation))
        self._states.append(simulation.save())

    def _ratio(self, simulation: Simulation) -> float:
        return distance(self._compiled_mechanism, simulation.t, simulation.stepper.q, self._rank)[0]

    def nearest(self, simulation: Simulation) -> Nearest | None:
        """Return where the run came nearest; it is taken back for that. None where nothing was looked at."""
        if not self._times:
            return None
        ratios = np.array([inf, *self._ratios, inf])
        less = (1.0 - RATIO_NOISE) * np.minimum(ratios[:-2], ratios[2:])
        least = np.flatnonzero((ratios[1:-1] < less) | (ratios[1:-1] == ratios.min()))
        least = least[np.argsort(ratios[1 + least], kind="stable")][:MAX_REFINED_MINIMA]
        found = [self._refined(simulation, int(k)) for k in least]
        smallest = min(ratio for _, ratio in found)
        level = max(EQUAL_RATIO_FACTOR * smallest, ZERO_RATIO)
        t, ratio = min((f for f in found if f[1] <= level), key=lambda f: f[0])
        self._go_to(simulation, int(np.searchsorted(self._times, t, side="right")) - 1, t)
        q = simulation.stepper.q
        return Nearest(
            t=t,
            ratio=ratio,
            loops=loops_of(self._compiled_mechanism, distance(self._compiled_mechanism, t, q, self._rank)[1]),
            gap=self._formulation.bifurcation_gap(t, q) if self._formulation is not None else nan,
            passes=sum(ratio <= NEAR_SINGULAR_RATIO for _, ratio in found),
        )

    def _go_to(self, simulation: Simulation, k: int, t: float) -> bool:
        """Take the run from sample k to t."""
        simulation.restore(self._states[k])
        return t <= simulation.t or simulation.advance(t).ok

    def _refined(self, simulation: Simulation, k: int) -> tuple[float, float]:
        """Return time and ratio of the minimum next to sample k."""
        times, here = self._times, (self._times[k], self._ratios[k])
        if here[1] > REFINED_RATIO_LIMIT or len(times) == 1:
            return here
        first, last = max(k - 1, 0), min(k + 1, len(times) - 1)

        def ratio(t: float) -> float:
            return self._ratio(simulation) if self._go_to(simulation, first, float(t)) else inf

        between, exact = (times[first], times[last]), MINIMUM_TIME_TOLERANCE * (times[last] - times[first])
        best = scipy.optimize.minimize_scalar(ratio, bounds=between, method="bounded", options={"xatol": exact})
        return (float(best.x), float(best.fun)) if best.fun < (1.0 - RATIO_NOISE) * here[1] else here
