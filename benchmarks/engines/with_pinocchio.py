"""Pinocchio: relative coordinates, loops by `constraintDynamics`; integrators of this file and of SciPy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import pi

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from .problems import END, FOURBAR, GOVERNOR, GRAVITY, LARGE_INERTIA, PENDULUM, TIMES, Array, Run

NAME = f"Pinocchio {pin.__version__}"
SETTINGS = (
    "classical Runge-Kutta (1 to 16 equal steps in 10 ms), and SciPy's DOP853 (`rtol` = `atol` = 1e-3 to 1e-12); "
    "accelerations by `aba` and `constraintDynamics` (proximal parameter 1e-8, 10 iterations) with Baumgarte's "
    "stabilization, Kp = 400 or 2500 1/s^2, Kd = 2 sqrt(Kp); a hub of 1e9 kg m^2 in place of a prescribed speed"
)
TINY = 1e-9  # kg and kg m^2, of a rod without mass
Slope = Callable[..., Array]


class Builder:
    """A model, its loops, and its springs."""

    def __init__(self, gravity: float) -> None:
        self.model = pin.Model()
        self.model.gravity.linear = np.array((0.0, -gravity, 0.0))
        self.loops = pin.StdVec_RigidConstraintModel()
        self.springs: list[tuple[int, float, float]] = []
        self.q: list[float] = []
        self.v: list[float] = []

    def body(
        self,
        parent: int,
        joint: pin.JointModel,
        at: tuple[float, float, float],
        start: float,
        rate: float,
        mass: float,
        com: tuple[float, float, float] = (0.0, 0.0, 0.0),
        inertia: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> int:
        """Add a body and its joint; return its number."""
        place = pin.SE3(np.eye(3), np.array(at))
        number = self.model.addJoint(parent, joint, place, f"joint{self.model.njoints}")
        self.model.appendBodyToJoint(number, pin.Inertia(mass, np.array(com), np.diag(inertia)), pin.SE3.Identity())
        self.q.append(start)
        self.v.append(rate)
        return int(number)

    def bar(
        self, parent: int, at: tuple[float, float, float], start: float, rate: float, mass: float, size: float
    ) -> int:
        """Add a uniform bar with a hinge about z."""
        across = mass * size * size / 12.0
        return self.body(parent, pin.JointModelRZ(), at, start, rate, mass, (0.5 * size, 0, 0), (0.0, across, across))

    def close(self, a: int, at_a: tuple[float, float, float], b: int, at_b: tuple[float, float, float]) -> None:
        """Let two points coincide."""
        places = (pin.SE3(np.eye(3), np.array(at)) for at in (at_a, at_b))
        first, second = places
        self.loops.append(
            pin.RigidConstraintModel(
                pin.ContactType.CONTACT_3D, self.model, a, first, b, second, pin.LOCAL_WORLD_ALIGNED
            )
        )

    def slope(self, stiffness: float) -> Slope:
        """Return what computes accelerations; ``stiffness``: that of the stabilization, 1/s^2."""
        for loop in self.loops:
            loop.m_baumgarte_parameters.Kp = stiffness
            loop.m_baumgarte_parameters.Kd = 2.0 * np.sqrt(stiffness)
        model, data, n = self.model, self.model.createData(), self.model.nv
        number = np.array([k for k, _, _ in self.springs], int)
        rates, free = (np.array([spring[i] for spring in self.springs]) for i in (1, 2))
        tau, loops = np.zeros(n), self.loops
        loop_data = pin.StdVec_RigidConstraintData()
        loop_data.extend([loop.createData() for loop in loops])
        proximal = pin.ProximalSettings(1e-12, 1e-8, 10)
        if loops:
            pin.initConstraintDynamics(model, data, loops, loop_data)

        def accelerations(q: Array, v: Array) -> Array:
            tau[number] = rates * (free - q[number])
            if loops:
                return np.asarray(pin.constraintDynamics(model, data, q, v, tau, loops, loop_data, proximal))
            return np.asarray(pin.aba(model, data, q, v, tau))

        return accelerations


def build(problem: str, loops: int) -> tuple[Builder, int]:
    """Return a problem and the number of the angle that is compared."""
    x = pin.JointModelRZ()
    if problem == "fourbar":
        p = FOURBAR
        m, angle, rate = Builder(p.gravity), p.start_angle, p.start_rate
        crank = m.bar(0, (0, 0, 0), angle, rate, p.crank_mass, p.crank_length)
        coupler = m.bar(crank, (p.crank_length, 0, 0), -angle, -rate, p.coupler_mass, p.coupler_length)
        rocker = m.bar(0, (p.ground_length, 0, 0), angle, rate, p.rocker_mass, p.rocker_length)
        m.close(coupler, (p.coupler_length, 0, 0), rocker, (p.rocker_length, 0, 0))
        return m, 0
    if problem == "governor":
        g, heavy = GOVERNOR, (LARGE_INERTIA,) * 3
        m = Builder(0.0)
        hub = m.body(0, pin.JointModelRY(), (0, 0, 0), 0.0, g.spindle_speed, 1.0, (0, 0, 0), heavy)
        distance = g.below_pivot(g.start_angle)
        slider = pin.JointModelPrismaticUnaligned(np.array((0.0, -1.0, 0.0)))
        inertia = (0.6 * g.collar_inertia, g.collar_inertia, 0.6 * g.collar_inertia)
        collar = m.body(hub, slider, (0, 0, 0), distance, 0.0, g.collar_mass, (0, 0, 0), inertia)
        m.springs.append((1, g.stiffness, g.free_length))
        for side in (-1.0, 1.0):
            hinge = pin.JointModelRevoluteUnaligned(np.array((0.0, 0.0, -side)))
            ball = (g.ball_inertia,) * 3
            arm = m.body(hub, hinge, (0, 0, 0), g.start_angle, 0.0, g.ball_mass, (side * g.arm_length, 0, 0), ball)
            end = side * g.rod_position * np.cos(g.start_angle), -g.rod_position * np.sin(g.start_angle)
            lean = np.arctan2(-distance - end[1], -end[0]) + side * g.start_angle
            pivot = (side * g.rod_position, 0.0, 0.0)
            rod = m.body(arm, x, pivot, lean, 0.0, TINY, (0, 0, 0), (TINY,) * 3)
            m.close(rod, (g.rod_length, 0, 0), collar, (0, 0, 0))
        return m, 2
    if problem == "pendulum":
        s, heavy = PENDULUM, (LARGE_INERTIA,) * 3
        m = Builder(0.0)
        hub = m.body(0, x, (0, 0, 0), 0.0, s.drive_speed, 1.0, (0, 0, 0), heavy)
        rod = m.body(hub, x, (s.crank_length, 0, 0), s.start_angle, 0.0, 0.0)
        m.body(rod, pin.JointModelPX(), (0, 0, 0), s.start_distance, 0.0, s.slider_mass)
        m.springs += [(1, s.swing_stiffness, 0.0), (2, s.slider_stiffness, s.free_length)]
        return m, 1
    m = Builder(GRAVITY)
    columns = [m.bar(0, (float(i), 0, 0), 0.5 * pi, -1.0, 1.0, 1.0) for i in range(loops + 1)]
    for i in range(loops):
        beam = m.bar(columns[i], (1, 0, 0), -0.5 * pi, 1.0, 1.0, 1.0)
        m.close(beam, (1, 0, 0), columns[i + 1], (1, 0, 0))
    return m, 0


def runs(problem: str, loops: int) -> Iterator[tuple[str, Run]]:
    """Yield a setting and what runs the problem with it."""
    m, angle = build(problem, loops)
    n, start = m.model.nv, np.array(m.q + m.v)
    for stiffness in (400.0, 2500.0) if len(m.loops) else (0.0,):
        accelerations = m.slope(stiffness)

        def slope(_: float, y: Array, accelerations: Slope = accelerations) -> Array:
            return np.concatenate((y[n:], accelerations(y[:n], y[n:])))

        for steps in (1, 2, 4, 8, 16):

            def run_equal(steps: int = steps, slope: Slope = slope) -> Array:
                y, h, found = start, TIMES[1] / steps, [start[angle]]
                for _ in TIMES[1:]:
                    for _ in range(steps):
                        k1 = slope(0.0, y)
                        k2 = slope(0.0, y + 0.5 * h * k1)
                        k3 = slope(0.0, y + 0.5 * h * k2)
                        k4 = slope(0.0, y + h * k3)
                        y = y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
                    found.append(y[angle])
                return np.array(found)

            yield f"RK4 {steps}, Kp {stiffness:g}", run_equal
        for tolerance in 10.0 ** np.arange(-3.0, -12.5, -1.0):

            def run_adaptive(tolerance: float = float(tolerance), slope: Slope = slope) -> Array:
                options = {"method": "DOP853", "rtol": tolerance, "atol": tolerance}
                found = solve_ivp(slope, (0.0, END), start, t_eval=TIMES, **options)
                return np.asarray(found.y[angle])

            yield f"DOP853 {tolerance:.0e}, Kp {stiffness:g}", run_adaptive
