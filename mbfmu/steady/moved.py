"""Steady states with supports that have moved: where none is found there, or one that is not stable, they are followed.

A thin sheet whose clamps come together has many steady states, of which only those that are bent are stable. From its
start, drawn where the clamps were, Newton finds a flat one, or none. The state before the motion is followed while all
steps go from nothing to their heights together, along the path of steady states (:mod:`solvers.statics.path`), and at
the first bifurcation onto the path that crosses there, if the first path does not end in a stable state.
"""

from __future__ import annotations

from itertools import islice

from mbfmu.errors import EquilibriumError
from mbfmu.model import Model
from mbfmu.steady.problem import EquilibriumProblem
from mbfmu.steady.state import Equilibrium
from solvers.linalg.blocks import one_thread
from solvers.statics.path import Follower, Load, State

STEPS = 400  # states on a path, at most
WAY = "the supports where they start, by following their motion"


def follow_supports(model: Model) -> Equilibrium:
    """Return the steady state that the one before all supports moved becomes.

    Raises
    ------
    EquilibriumError
        There is none before, or the path ends earlier.
    """
    plant = model.plant()
    own = plant.drives.steps(plant.signals(plant.data))
    heights, offsets = ([float(step.record[name]) for step in own] for name in ("height", "offset"))
    for step in own:
        step.record["height"] = 0.0
    plant.drives.finish_run_ups()
    problem = EquilibriumProblem(model, plant)
    both = list(zip(own, plant.drives.steps(problem.signals), heights, offsets, strict=True))

    def apply(part: float) -> None:
        """Let the supports have gone a part of their way."""
        for step, twin, height, offset in both:
            step.record["offset"] = twin.record["offset"] = offset + part * height

    apply(0.0)
    before = problem.solve()
    with one_thread():
        follower = Follower(problem.linearized(), Load(apply, 0.0, 1.0), before.q, before.lam[before.rows])
        states = list(islice(follower.follow(follower.start), STEPS))
        end = arrived(states)
        crossings = [state for state in states if state.kind == "bifurcation"]
        if (end is None or end.unstable) and crossings:
            side = list(islice(follower.follow(follower.second(crossings[0], 1.0)), STEPS))
            end = arrived(side) or end
    if end is None:
        reached = f": {follower.ended}" if follower.ended else ""
        raise EquilibriumError(
            f"no steady state of {model.name!r} was found by following the motion of its supports{reached}"
        )
    apply(1.0)
    return problem.state(end.q, end.lam, WAY)


def arrived(states: list[State]) -> State | None:
    """Return the last state if the supports are at the end of their motion there."""
    return states[-1] if states and states[-1].p == 1.0 else None
