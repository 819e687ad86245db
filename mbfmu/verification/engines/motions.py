"""Motions of random trees, from accelerations of other engines that SciPy integrates."""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from mbfmu.mechanics import Mechanism
from mbfmu.verification.problem import Exact, Motion, Solution
from mbfmu.verification.verdict import Line, check, methods_of

from . import with_mbfmu
from .compare import ENGINES
from .random_trees import Array, Evaluator, Link, random_tree, start_of

STOP_TIME = 0.5  # s
MOTION_PRECISION, ROUGH_PRECISION = 1e-11, 1e-8  # relative tolerances of the reference and of its sensitivities
TOLERANCES = (1e-6, 1e-8)


def turned(axis: Array, angle: float) -> Array:
    """Return the rotation matrix (3, 3) of a rotation about a unit vector (formula of Rodrigues)."""
    x, y, z = axis
    S = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    return np.asarray(np.eye(3) + np.sin(angle) * S + (1.0 - np.cos(angle)) * S @ S)


def rotation_of(quaternion: Array) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion (4,), scalar first, of any length."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    S = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    return np.asarray(np.eye(3) + 2.0 * w * S + 2.0 * S @ S)


def centers(links: list[Link], position: Array) -> Array:
    """Return the centers of mass of the links in ground axes (3 N,), m."""
    R, r, found, first = [np.eye(3)], [np.zeros(3)], [], 0
    for link in links:
        A, p = R[link.parent + 1], r[link.parent + 1]
        p, A = p + A @ link.place, A @ link.rotation
        own = position[first : first + len(link.position)]
        first += len(own)
        if link.joint == "spherical":
            A = A @ rotation_of(own)
        else:
            for (kind, axis), value in zip(link.parts, own, strict=True):
                p, A = (p + A @ axis * value, A) if kind == "translational" else (p, A @ turned(axis, value))
        R.append(A)
        r.append(p)
        found.append(p + A @ link.com)
    return np.concatenate(found)


def derivative(links: list[Link], evaluate: Evaluator, t: float, y: Array) -> Array:
    """Return the derivatives of positions and rates; of a quaternion e, e' = e (0, w) / 2 with w in the body."""
    size = sum(len(link.position) for link in links)
    position, rate, slopes, first = y[:size].copy(), y[size:], np.empty(len(y)), [0, 0]
    for link in links:
        at, own = slice(first[0], first[0] + len(link.position)), rate[first[1] : first[1] + len(link.rate)]
        first = [at.stop, first[1] + len(link.rate)]
        if link.joint != "spherical":
            slopes[at] = own
            continue
        scalar, vector = position[at][0], position[at][1:]
        slopes[at] = 0.5 * np.array((-vector @ own, *(scalar * own + np.cross(vector, own))))
        position[at] /= np.linalg.norm(position[at])
    slopes[size:] = evaluate(position, rate).acceleration
    return slopes


def motion(links: list[Link], evaluate: Evaluator, precision: float) -> Solution:
    """Return the centers of mass at times as a function of the start: positions and rates of all links."""

    def solution(start: Array, times: Array) -> Array:
        solved = solve_ivp(
            partial(derivative, links, evaluate), times[[0, -1]], start, "DOP853", times, rtol=precision, atol=precision
        )
        size = sum(len(link.position) for link in links)
        return np.array([centers(links, y[:size]) for y in solved.y.T])

    return solution


def build(links: list[Link], gravity: Array) -> Mechanism:
    """Return the mechanism, whose outputs are the centers of mass."""
    m = with_mbfmu.build(links, gravity)
    for k, link in enumerate(links):
        for axis in "xyz":
            m.output(f"link{k}.{axis}", m.bodies[k + 1].position(axis, tuple(link.com)))
    return m


def motion_problem(seed: int, package: str) -> Motion:
    """Return the motion of a random tree, to be compared with that of an engine, given by its package."""
    links, gravity = random_tree(seed)
    title, engine = ENGINES[package]
    evaluate, start = engine.evaluator(links, gravity), np.concatenate(start_of(links))
    solution, rough = (motion(links, evaluate, precision) for precision in (MOTION_PRECISION, ROUGH_PRECISION))
    exact = Exact(solution, tuple(start), tuple(np.maximum(1.0, np.abs(start))), 100.0 * MOTION_PRECISION, rough)
    return Motion(
        name=f"tree {seed}, {title}",
        description=f"Random tree of {len(links)} links.",
        quantity="Centers of mass",
        unit="m",
        derivation=f"SciPy DOP853 on accelerations of {title}",
        build=partial(build, links, gravity),
        outputs=tuple(f"link{k}.{axis}" for k in range(len(links)) for axis in "xyz"),
        exact=lambda: exact,
        stop_time=STOP_TIME,
    )


def compare_motions(seed: int, package: str) -> list[Line]:
    """Return the comparison of the motion of a random tree by every solver that accepts it."""
    problem = motion_problem(seed, package)
    return list(check(problem, methods_of(problem, ()), TOLERANCES))
