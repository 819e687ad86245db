"""Steady states with supports that have moved: where none is found there, or one that is not stable, they are followed.

A thin sheet whose clamps come together has many steady states, of which only those that are bent are stable. From its
start, drawn where the clamps were, Newton finds a flat one, or none. The state before the motion is followed while all
supports go to their positions together, along the path of steady states (:mod:`solvers.statics.path`), and at the first
bifurcation onto the path that crosses there, if the first path does not end in a stable state; and so on from that
path.

A support moves by a :class:`~mbfmu.mechanics.signals.Step`, which starts at its offset, or by an input of position,
which starts at its start value. It is followed from there, then from zero. A constant position of a drive is part of
the geometry, not a motion.
"""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.signals import InUse
from mbfmu.steady.state import Equilibrium
from mbfmu.util.errors import EquilibriumError
from solvers.linalg.threads import one_thread
from solvers.statics.path import Follower, Load, State
from solvers.system import Array

if TYPE_CHECKING:
    from mbfmu.steady.problem import EquilibriumProblem

MAX_SUPPORT_PATH_STATES = 400  # states on a path, at most
MAX_SUPPORT_PATHS, MAX_SUPPORT_STATES = 8, 800  # paths that are followed, and states on all of them, at most
FOLLOWED_TEXT = "the supports where they start, by following their motion"


class Supports:
    """Positions of the supports of a compiled mechanism that steps and inputs move, those of steps first.

    Parameters
    ----------
    compiled
        CompiledMechanism whose steps have not been taken to their ends yet.
    finishes
        Whether they will be. Else they are held at t = 0, because a run starts in the steady state.
    """

    def __init__(self, compiled: CompiledMechanism, *, finishes: bool) -> None:
        signals, self.finishes = compiled.signals(compiled.data), finishes
        steps = [step.record for step in compiled.drives.steps(signals)] if finishes else []
        self._before = [float(record["offset"]) for record in steps]
        self._zero = [0.0 if record["height"] else float(record["offset"]) for record in steps]
        self._steps, self._compiled_mechanism, self._inputs = [steps], compiled, compiled.inputs.positions()
        self._places = [compiled.inputs.places(compiled.data.arrays, signals)]

    def add_complex_copy(self, arrays: Any, signals: list[InUse]) -> None:
        """Let the supports of the complex twin of the compiled mechanism move as well."""
        if self._before:
            self._steps.append([step.record for step in self._compiled_mechanism.drives.steps(signals)])
        self._places.append(self._compiled_mechanism.inputs.places(arrays, signals))

    def positions(self) -> Array:
        """Return where the supports are, m or rad."""
        inputs = [array[k] for array, k in (self._places[0][index] for index in self._inputs)]
        return np.array([*(record["offset"] for record in self._steps[0]), *inputs], float)

    def beginnings(self) -> list[Array]:
        """Return from where the supports have come to their positions: from where they start, then from zero."""
        here, found = self.positions(), list[Array]()
        starts = [self._compiled_mechanism.inputs.variables[index].start for index in self._inputs]
        for places in ([*self._before, *starts], [*self._zero, *(0.0 for _ in starts)]):
            begin = np.array(places)
            if not any(np.array_equal(begin, other) for other in (here, *found)):
                found.append(begin)
        return found

    def move(self, positions: Array) -> None:
        """Let the supports be at positions, m or rad."""
        count = len(self._before)
        for records in self._steps:
            for record, position in zip(records, positions[:count], strict=True):
                record["offset"] = position
        for index, position in zip(self._inputs, positions[count:], strict=True):
            self._compiled_mechanism.inputs.start(index, float(position))
            for places in self._places[1:]:
                array, k = places[index]
                array[k] = position


def follow_supports(problem: EquilibriumProblem, begin: Array) -> Equilibrium:
    """Return the steady state that the one with the supports at ``begin`` becomes.

    Raises
    ------
    UserError
        There is none at the beginning, or the path ends earlier.
    """
    supports, started = problem.supports, time.perf_counter()
    here = supports.positions()

    def apply(part: float) -> None:
        """Let the supports have gone a part of their way."""
        supports.move(here if part == 1.0 else begin + part * (here - begin))

    try:
        apply(0.0)
        before = problem.solve(problem.start())
        with one_thread():
            at, load = problem.unknowns(before), Load(apply, 0.0, 1.0)
            follower = Follower(problem.linearized(), load, at, before.lam[before.rows])
            end = find_end(follower)
        if end is None:
            reached = f": {follower.ended}" if follower.ended else ""
            raise EquilibriumError(
                f"no steady state of {problem.model.name!r} was found by following the motion of its supports{reached}"
            )
    finally:
        apply(1.0)
    found = problem.state(end.q, end.lam, FOLLOWED_TEXT)
    return replace(found, solve_time=time.perf_counter() - started)


def find_end(follower: Follower) -> State | None:
    """Return the state at the end of the motion of the supports: a stable one, else the last that was found.

    From each path whose end is unstable or not reached, the path that crosses it first is followed, until a stable
    end, a path without a bifurcation, or the limits of paths and states.
    """
    end, start, left = None, follower.start, MAX_SUPPORT_STATES
    for _ in range(MAX_SUPPORT_PATHS):
        states = list(islice(follower.follow(start), min(MAX_SUPPORT_PATH_STATES, left)))
        left -= len(states)
        end = arrived(states) or end
        crossing = next((state for state in states if state.kind == "bifurcation"), None)
        if crossing is None or (end is not None and not end.unstable):
            break
        start = follower.branch_start(crossing, 1.0)
    return end


def arrived(states: list[State]) -> State | None:
    """Return the last state if the supports are at the end of their motion there."""
    return states[-1] if states and states[-1].p == 1.0 else None
