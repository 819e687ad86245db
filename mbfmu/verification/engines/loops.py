"""Random mechanisms with loops: accelerations by mbfmu and by Pinocchio.

A loop is a ball joint between two points that coincide at the start. Its constraints are solved by each engine itself.
Rates are projected onto the constraints, whose Jacobian Pinocchio evaluates.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mbfmu.mechanics import CompiledMechanism, SphericalCutJoint
from mbfmu.util.extras import import_optional
from solvers import Options, stepper

from . import with_mbfmu
from .compare import ROUNDING_FACTOR, Difference
from .random_trees import Array, Link, random_tree, start_of
from .with_pinocchio import Tree

MAX_LOOPS = 2
MAX_CONDITION = 1e3  # of the constraint Jacobian: nearer to singular configurations mechanisms are not compared
PROXIMAL = (1e-12, 1e-10, 20)  # accuracy, regularization and iterations of the solver of Pinocchio


class Loop(NamedTuple):
    """Ball joint between points (3,) of two links, in their frames, m."""

    a: int
    b: int
    at_a: Array
    at_b: Array


class LoopAccelerations(NamedTuple):
    """Accelerations (n,) by mbfmu and by Pinocchio, and the condition of the mass matrix times that of J squared."""

    ours: Array
    theirs: Array
    condition: float


def random_loops(links: list[Link], tree: Tree, rng: np.random.Generator) -> list[Loop]:
    """Return up to MAX_LOOPS loops between different links, with three degrees of freedom less for each."""
    pin, size = tree.pin, tree.model.nv
    q, _ = tree.state(*start_of(links))
    pin.forwardKinematics(tree.model, tree.data, q)
    loops = []
    for _ in range(min(MAX_LOOPS, (size - 1) // 3 if len(links) > 1 else 0)):
        a, b = map(int, rng.choice(len(links), size=2, replace=False))
        at_a = rng.normal(size=3)
        place_a, place_b = (tree.data.oMi[tree.numbers[k]] for k in (a, b))
        loops.append(Loop(a, b, at_a, place_b.actInv(place_a.act(at_a))))
    return loops


def jacobian(tree: Tree, link: int, at: Array) -> Array:
    """Return the Jacobian (3, n) of the velocity of a point of a link, in ground axes."""
    number = tree.numbers[link]
    J = tree.pin.getJointJacobian(tree.model, tree.data, number, tree.pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    arm = tree.data.oMi[number].rotation @ at
    return np.asarray(J[:3] + np.cross(J[3:].T, arm).T)


def compare_loops(seed: int) -> LoopAccelerations | None:
    """Return the accelerations of a random mechanism with loops; None if it has none, or is nearly singular."""
    links, gravity = random_tree(seed)
    tree = Tree(links, gravity)
    pin, rng = tree.pin, np.random.default_rng((seed, 1))
    loops = random_loops(links, tree, rng)
    if not loops:
        return None
    position, rate = start_of(links)
    q, v = tree.state(position, rate)
    frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    models, states = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for loop in loops:
        model = pin.RigidConstraintModel(
            pin.ContactType.CONTACT_3D,
            tree.model,
            tree.numbers[loop.a],
            pin.SE3(np.eye(3), loop.at_a),
            tree.numbers[loop.b],
            pin.SE3(np.eye(3), loop.at_b),
            frame,
        )
        models.append(model)
        states.append(model.createData())
    pin.computeJointJacobians(tree.model, tree.data, q)
    J = np.vstack([jacobian(tree, loop.a, loop.at_a) - jacobian(tree, loop.b, loop.at_b) for loop in loops])
    sizes = np.linalg.svd(J, compute_uv=False)
    if sizes[0] > MAX_CONDITION * sizes[-1]:
        return None
    v = v - np.linalg.pinv(J) @ (J @ v)
    pin.initConstraintDynamics(tree.model, tree.data, models, states)
    settings = pin.ProximalSettings(*PROXIMAL)
    theirs = pin.constraintDynamics(tree.model, tree.data, q, v, np.zeros(tree.model.nv), models, states, settings)
    m = with_mbfmu.build(links, gravity)
    for k, loop in enumerate(loops):
        joint = SphericalCutJoint(at_a=tuple(loop.at_a), at_b=tuple(loop.at_b))
        m.cut(f"loop{k}", joint, m.bodies[1 + loop.a], m.bodies[1 + loop.b])
    compiled = CompiledMechanism(m)
    motion = stepper("adams", compiled.system, 0.0, position, v[tree.v_order], Options(rtol=1e-8))
    code, ours, _ = motion.evaluate()
    assert code.name == "OK", code
    mass = np.linalg.cond(pin.crba(tree.model, tree.data, q))
    return LoopAccelerations(ours, np.array(theirs)[tree.v_order], float(mass * (sizes[0] / sizes[-1]) ** 2))


def compare_random_loops(count: int, progress: Callable[[str], None] | None = None) -> Difference:
    """Compare mechanisms with loops among ``count`` random mechanisms with Pinocchio."""
    import_optional("pinocchio", "bench")
    compared, largest = 0, np.zeros(2)
    for seed in range(count):
        found = compare_loops(seed)
        if found is not None:
            compared += 1
            rates = np.abs(found.theirs - found.ours).max() / np.abs(found.ours).max()
            largest = np.maximum(largest, (rates, rates / (ROUNDING_FACTOR * np.finfo(float).eps * found.condition)))
        if progress is not None:
            progress("Pinocchio")
    return Difference("Pinocchio, with loops", compared, None, *map(float, largest))
