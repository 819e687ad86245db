"""Mechanisms without loops, with motions that SciPy integrates from equations written by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import cos, pi, sin
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from mbfmu.mechanics import Mechanism, Revolute, Translational, rod

from .case import PRECISION, Case, ExactMotion, G

Embedding = Callable[[Any, Any], tuple[Any, Any]]  # positions and rates, (k, n) each, to q and v
CORNER = 1e-12  # s, by which an integration continues behind a time at which the equations are not smooth


def integrated(
    acceleration: Callable[[Any, Any], Any], start: Any, rate: Any, embed: Embedding, breaks: Any
) -> ExactMotion:
    """Return the motion of x'' = acceleration(x, x').

    Parameters
    ----------
    acceleration
        Function of positions and rates (n,).
    start, rate
        Positions and rates (n,) at the first time.
    embed
        Returns the coordinates and velocities of a mechanism for positions and rates (k, n).
    breaks
        Functions of (t, y) that are zero where the equations are not smooth; None: they are smooth.

    Returns
    -------
    Function of times (k,) and of a ``nudge``: a change of positions and rates with random signs at each of the times.
    """
    x, v = np.atleast_1d(np.asarray(start, float)), np.atleast_1d(np.asarray(rate, float))
    n = len(x)

    def right(_: float, y: Any) -> Any:
        return np.concatenate((y[n:], np.atleast_1d(acceleration(y[:n], y[n:]))))

    def follow(begin: float, end: float, y: Any) -> Any:
        while begin < end:
            part = solve_ivp(right, (begin, end), y, events=breaks, **PRECISION)
            begin, y = part.t[-1], part.y[:, -1]
            if begin < end:
                ahead = min(CORNER, end - begin)
                begin, y = begin + ahead, y + ahead * right(begin, y)
        return y

    def exact(times: Any, nudge: float = 0.0) -> tuple[Any, Any]:
        rows, rng = [np.concatenate((x, v))], np.random.default_rng(len(times))
        for begin, end in pairwise(np.asarray(times, float)):
            y = rows[-1] + nudge * rng.choice((-1.0, 1.0), 2 * n) if nudge else rows[-1]
            rows.append(follow(begin, end, y))
        y = np.array(rows)
        return embed(y[:, :n], y[:, n:])

    return exact


def light_cart(ratio: float = 1e-6, size: float = 1.0) -> Case:
    """Return a pendulum of 1 kg and ``size`` (m) on a cart of ``ratio`` kg, released horizontally.

    det M is proportional to ratio + sin^2 of the angle from the vertical: it decreases to ``ratio`` at each passage.
    """
    m = Mechanism(gravity=(0.0, -G, 0.0))
    cart = m.body("cart", m.ground, Translational(axis="x"), mass=ratio)
    joint = Revolute(start=0.5 * pi, fixed=True)
    m.body("pole", cart, joint, mass=1.0, com=(0.0, -size, 0.0), inertia=(0.0, 0.0, 0.0))

    def acceleration(q: Any, v: Any) -> Any:
        s, c, g = sin(q[1]), cos(q[1]), G / size
        moving = ratio + s * s
        shift = size * s * (v[1] ** 2 + g * c) / moving
        return np.array((shift, -((1.0 + ratio) * g * s + s * c * v[1] ** 2) / moving))

    stop_time = 10.0 * size**0.5
    return Case(m, integrated(acceleration, (0.0, 0.5 * pi), (0.0, 0.0), lambda q, v: (q, v), None), stop_time)


def pendulum_among(count: int) -> Case:
    """Return one swinging rod and others at rest, with ``count`` coordinates."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    for k in range(count):
        m.body(f"rod{k}", m.ground, Revolute(start=-0.5 * pi + (1.0 if k == 0 else 0.0)), **rod(mass=1.0, length=1.0))

    def embed(q: Any, v: Any) -> tuple[Any, Any]:
        rest = np.full((len(q), count - 1), -0.5 * pi)
        return np.hstack((q, rest)), np.hstack((v, 0.0 * rest))

    return Case(m, integrated(lambda q, _: -1.5 * G * np.cos(q), -0.5 * pi + 1.0, 0.0, embed, None), 2.0)


def chain(links: int) -> Case:
    """Return a straight hanging chain of rods, of 1 m and 1 kg, released at 0.5 rad from the vertical."""
    mass = length = 1.0 / links
    m = Mechanism(gravity=(0.0, -G, 0.0))
    body = m.ground
    for k in range(links):
        joint = Revolute(at=(length if k else 0.0, 0.0, 0.0), start=0.0 if k else -0.5 * pi + 0.5, fixed=True)
        body = m.body(f"link{k}", body, joint, **rod(mass=mass, length=length))

    # absolute angles a: sum_j m_ij (cos(a_i - a_j) a_j'' + sin(a_i - a_j) a_j'^2) = -w_i cos a_i
    below = links - 1 - np.maximum.outer(np.arange(links), np.arange(links))
    coupling = mass * length**2 * (below + 0.5 * (1.0 - np.eye(links)) + np.eye(links) / 3.0)
    weight = mass * G * length * (links - 1 - np.arange(links) + 0.5)

    def acceleration(a: Any, b: Any) -> Any:
        lag = a[:, None] - a[None, :]
        return np.linalg.solve(coupling * np.cos(lag), -weight * np.cos(a) - coupling * np.sin(lag) @ b**2)

    def embed(a: Any, b: Any) -> tuple[Any, Any]:
        return np.diff(a, axis=1, prepend=0.0), np.diff(b, axis=1, prepend=0.0)

    start: Sequence[float] = np.full(links, -0.5 * pi + 0.5).tolist()
    return Case(m, integrated(acceleration, start, np.zeros(links), embed, None), 1.0)
