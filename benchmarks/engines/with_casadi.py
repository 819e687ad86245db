"""CasADi: Lagrange's equations are derived symbolically, with constraints as equations of accelerations (index 1)."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from math import pi

import casadi as ca
import numpy as np

from .problems import FOURBAR, GOVERNOR, GRAVITY, PENDULUM, TIMES, Array, Run

NAME = f"CasADi {ca.__version__}"
SETTINGS = (
    "CVODES (adams and bdf) on accelerations that are eliminated symbolically, up to 8 unknowns; IDAS with "
    "accelerations and multipliers as algebraic variables; constraints plain, or with Baumgarte's stabilization (Kp = "
    "400 1/s^2, Kd = 2 sqrt(Kp)) and multipliers regularized by 1e-9; `reltol` = `abstol` = 1e-3 to 1e-12; expressions "
    "of type SX, compiled by a C compiler (-O2)"
)
TOLERANCES = 10.0 ** np.arange(-3.0, -12.5, -1.0)
REGULARIZATION = 1e-9  # 1/kg, of the multipliers of stabilized constraints: for singular configurations
MAX_ELIMINATED = 8  # accelerations and multipliers that are eliminated as expressions


class Equations:
    """Kinetic and potential energy and constraints, of coordinates q and velocities v, and the start."""

    def __init__(self, n: int) -> None:
        self.q, self.v = ca.SX.sym("q", n), ca.SX.sym("v", n)
        self.kinetic = self.potential = ca.SX(0.0)
        self.gaps: list[ca.SX] = []
        self.start = np.zeros(2 * n)

    def add_bar(self, x: ca.SX, y: ca.SX, angle: int, mass: float, length: float, gravity: float) -> None:
        """Add a bar whose center is at x, y."""
        u, w = (ca.jtimes(place, self.q, self.v) for place in (x, y))
        rate = self.v[angle]
        self.kinetic += 0.5 * mass * (u * u + w * w) + mass * length**2 / 24.0 * rate * rate
        self.potential += mass * gravity * y

    def system(self, stiffness: float) -> tuple[ca.SX, ca.SX]:
        """Return the matrix of accelerations and multipliers, and the right-hand side; ``stiffness``: that of the
        stabilization, 1/s^2.
        """
        q, v = self.q, self.v
        momentum = ca.gradient(self.kinetic, v)
        M = ca.jacobian(momentum, v)
        forces = ca.gradient(self.kinetic - self.potential, q) - ca.jtimes(momentum, q, v)
        if not self.gaps:
            return M, forces
        gaps = ca.vertcat(*self.gaps)
        J = ca.jacobian(gaps, q)
        rates = ca.jtimes(gaps, q, v)
        bias = -ca.jtimes(rates, q, v) - 2.0 * np.sqrt(stiffness) * rates - stiffness * gaps
        m = len(self.gaps)
        return ca.blockcat([[M, J.T], [J, -REGULARIZATION * ca.SX.eye(m) if stiffness else ca.SX(m, m)]]), ca.vertcat(
            forces, bias
        )


def equations(problem: str, loops: int) -> Equations:
    """Return the equations of a problem."""
    if problem == "fourbar":
        p = FOURBAR
        e = Equations(3)
        a, b, c = e.q[0], e.q[1], e.q[2]
        pin = ca.vertcat(p.crank_length * ca.cos(a), p.crank_length * ca.sin(a))
        end = pin + p.coupler_length * ca.vertcat(ca.cos(b), ca.sin(b))
        arm = p.rocker_length * ca.vertcat(ca.cos(c), ca.sin(c))
        e.add_bar(0.5 * pin[0], 0.5 * pin[1], 0, p.crank_mass, p.crank_length, p.gravity)
        e.add_bar(0.5 * (pin + end)[0], 0.5 * (pin + end)[1], 1, p.coupler_mass, p.coupler_length, p.gravity)
        e.add_bar(0.5 * arm[0], 0.5 * arm[1], 2, p.rocker_mass, p.rocker_length, p.gravity)
        e.gaps += [end[0] - arm[0] - p.ground_length, end[1] - arm[1]]
        e.start[:] = (p.start_angle, 0.0, p.start_angle, p.start_rate, 0.0, p.start_rate)
    elif problem == "governor":
        g = GOVERNOR
        e, w = Equations(3), g.spindle_speed
        for k in range(2):
            turning = g.ball_mass * g.arm_length**2
            e.kinetic += 0.5 * (turning + g.ball_inertia) * e.v[k] ** 2
            e.kinetic += 0.5 * turning * w**2 * ca.cos(e.q[k]) ** 2
            x, y = g.rod_position * ca.cos(e.q[k]), g.rod_position * ca.sin(e.q[k])
            e.gaps.append((x**2 + (e.q[2] - y) ** 2 - g.rod_length**2) / (2.0 * g.rod_length))
        e.kinetic += 0.5 * g.collar_mass * e.v[2] ** 2
        e.potential += 0.5 * g.stiffness * (e.q[2] - g.free_length) ** 2
        e.start[:3] = (g.start_angle, g.start_angle, g.below_pivot(g.start_angle))
    elif problem == "pendulum":
        s = PENDULUM
        e, w = Equations(2), s.drive_speed
        place = ca.vertcat(s.crank_length + e.q[1] * ca.cos(e.q[0]), e.q[1] * ca.sin(e.q[0]))
        rate = ca.jtimes(place, e.q, e.v) + w * ca.vertcat(-place[1], place[0])
        e.kinetic += 0.5 * s.slider_mass * ca.dot(rate, rate)
        e.potential += 0.5 * s.swing_stiffness * e.q[0] ** 2
        e.potential += 0.5 * s.slider_stiffness * (e.q[1] - s.free_length) ** 2
        e.start[:2] = (s.start_angle, s.start_distance)
    else:
        e = Equations(2 * loops + 1)
        tops = [ca.vertcat(i + ca.cos(e.q[i]), ca.sin(e.q[i])) for i in range(loops + 1)]
        for i in range(loops + 1):
            e.add_bar(0.5 * ca.cos(e.q[i]), 0.5 * ca.sin(e.q[i]), i, 1.0, 1.0, GRAVITY)
        for i in range(loops):
            k = loops + 1 + i
            end = tops[i] + ca.vertcat(ca.cos(e.q[k]), ca.sin(e.q[k]))
            middle = 0.5 * (tops[i] + end)
            e.add_bar(middle[0], middle[1], k, 1.0, 1.0, GRAVITY)
            e.gaps += [(end - tops[i + 1])[0], (end - tops[i + 1])[1]]
        e.start[: loops + 1], e.start[2 * loops + 1 : 3 * loops + 2] = 0.5 * pi, -1.0
    return e


def runs(problem: str, loops: int) -> Iterator[tuple[str, Run]]:
    """Yield a setting and what runs the problem with it."""
    e = equations(problem, loops)
    n, x = e.q.numel(), ca.vertcat(e.q, e.v)
    methods: dict[str, tuple[str, dict[str, ca.SX], dict[str, str]]] = {}
    for stiffness in (400.0, 0.0) if e.gaps else (0.0,):
        matrix, right = e.system(stiffness)
        unknowns = ca.SX.sym("unknowns", right.numel())
        name = f", Kp {stiffness:g}" if e.gaps else ""
        if right.numel() <= MAX_ELIMINATED:
            explicit = {"x": x, "ode": ca.vertcat(e.v, ca.solve(matrix, right)[:n])}
            for steps in ("adams", "bdf"):
                methods[f"CVODES {steps}{name}"] = ("cvodes", explicit, {"linear_multistep_method": steps})
        implicit = {"x": x, "z": unknowns, "ode": ca.vertcat(e.v, unknowns[:n]), "alg": matrix @ unknowns - right}
        methods[f"IDAS{name}"] = ("idas", implicit, {})
    compiled = {"jit": True, "compiler": "shell", "jit_options": {"flags": ["-O2"]}} if shutil.which("gcc") else {}
    for name, (solver, dae, options) in methods.items():
        for tolerance in TOLERANCES:
            own = {**options, **compiled, "reltol": tolerance, "abstol": tolerance, "max_num_steps": 10**5}
            integrator = ca.integrator("motion", solver, dae, 0.0, TIMES, own)

            def run(integrator: ca.Function = integrator) -> Array:
                return np.asarray(integrator(x0=e.start)["xf"])[0]

            yield f"{name} {tolerance:.0e}", run
