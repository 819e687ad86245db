"""Wheels that roll without slip on profiles, against closed forms, quadratures and SciPy on other coordinates."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.session.kernels.profile_contacts import locate_contact
from mbfmu.studies.check_report import format_findings
from mbfmu.testing.identities import constraint_rates, random_state
from mbfmu.util.errors import UserError
from mbfmu.viewer.profiles import profile_shapes

G = 9.81
WAVE, HEIGHT = 6.0, 0.3  # length and amplitude of a sine, in radii of the wheel
SIZES = [1e-3, 1.0, 1e3]


class Slopes(NamedTuple):
    """Height of a profile and its first three derivatives at a place."""

    h: Any
    h1: Any
    h2: Any
    h3: Any


class Sine:
    """z = a sin(k x) for a wheel of radius R, as an expression or as points of a periodic table."""

    def __init__(self, R: float, points: int = 0) -> None:
        self.R, self.a, self.k = R, HEIGHT * R, 2.0 * np.pi / (WAVE * R)
        self.table = None
        if points:
            x = np.linspace(0.0, WAVE * R, points)
            y = self.a * np.sin(self.k * x)
            y[-1] = y[0]
            self.table = mb.Table(x, y, beyond="periodic")
            self.spline = CubicSpline(x, y, bc_type="periodic")

    def __call__(self, x: Any) -> Slopes:
        if self.table is not None:
            k = int((x % (WAVE * self.R)) / (WAVE * self.R) * (len(self.spline.x) - 1))
            d = x % (WAVE * self.R) - self.spline.x[k]
            c3, c2, c1, c0 = self.spline.c[:, k].tolist()
            slopes = c1 + d * (2.0 * c2 + 3.0 * d * c3), 2.0 * c2 + 6.0 * d * c3, 6.0 * c3
            return Slopes(c0 + d * (c1 + d * (c2 + d * c3)), *slopes)
        s, c = self.a * np.sin(self.k * x), self.a * np.cos(self.k * x)
        return Slopes(s, self.k * c, -(self.k**2) * s, -(self.k**3) * c)

    def options(self) -> dict[str, Any]:
        """Return the arguments of a wheel on it."""
        if self.table is not None:
            return {"profile": self.table}
        interval = (-20.0 * self.R, 20.0 * self.R)
        return {"profile": f"{self.a!r} * sin({self.k!r} * x)", "profile_interval": interval}


class Planar:
    """A wheel in the plane of its profile. State: x of the contact and its rate.

    The center is at p = (x - R h1 / sigma, h + R / sigma), p' = g tau with g = sigma (1 - kappa R), and the rotation
    relative to the profile has the rate g x' / R. Lagrange's equation for x on a base that turns by alpha about y::

        (m + C / R^2) g (g x'' + g' x'^2) + (m (a_base . tau) + C alpha'' / R) g = m (gravity . tau) g
    """

    def __init__(self, profile: Any, R: float, hoop: float = 0.5) -> None:
        self.profile, self.R, self.m = profile, R, 2.0 * R**3
        self.C = hoop * self.m * R**2

    def center(self, x: Any) -> tuple[Any, Any, Any, Any]:
        """Return p, tau, n and g."""
        h, h1, h2, _ = self.profile(x)
        sigma = np.sqrt(1.0 + h1 * h1)
        tau, n = np.array((1.0, h1)) / sigma, np.array((-h1, 1.0)) / sigma
        return np.array((x, h)) + self.R * n, tau, n, sigma - self.R * h2 / sigma**2

    def rate_of_g(self, x: float) -> float:
        """Return dg/dx."""
        _, h1, h2, h3 = self.profile(x)
        sigma = np.sqrt(1.0 + h1 * h1)
        return float(h1 * h2 / sigma - self.R * (h3 / sigma**2 - 2.0 * h1 * h2**2 / sigma**4))

    def accelerate(self, x: float, v: float, w: float, dw: float, down: Any) -> tuple[float, Any]:
        """Return x'' and the force on the wheel in the axes of the profile, which turns with the rate w about y."""
        p, tau, n, g = self.center(x)
        dg, (_, h1, h2, _) = self.rate_of_g(x), self.profile(x)
        kappa = h2 / (1.0 + h1 * h1) ** 1.5
        quarter = np.array((p[1], -p[0]))  # y x p
        base = dw * quarter - w * w * p
        drive = self.m * (down - base) @ tau - self.C * dw / self.R
        a = (drive / (self.m + self.C / self.R**2) - dg * v * v) / g
        sigma = np.sqrt(1.0 + h1 * h1)
        moving = (g * a + dg * v * v) * tau + g * v * kappa * sigma * v * n
        coriolis = 2.0 * w * g * v * np.array((tau[1], -tau[0]))
        return float(a), self.m * (moving + coriolis + base - down)

    def model(self, x: float, v: float, down: Any, base: Any = None, **options: Any) -> mb.Mechanism:
        """Return the mechanism that starts with the contact at x, moving at v."""
        m = mb.Mechanism(gravity=(down[0], 0.0, down[1]))
        p, tau, _, g = self.center(x)
        ground, angle, rate = m.ground, 0.0, 0.0
        if base is not None:
            drive = mb.Revolute(axis="y", drive=mb.Polynomial(base))
            ground, (angle, rate) = m.body("base", m.ground, drive, mass=1.0, inertia=(1.0, 1.0, 1.0)), base[:2]
        turn = np.array(((np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))))
        p, (vx, vz) = turn @ p, turn @ (g * v * tau + rate * np.array((p[1], -p[0])))
        along = m.body("along", m.ground, mb.Translational(axis="x", start=p[0], rate=vx))
        lift = m.body("lift", along, mb.Translational(axis="z", start=p[1], rate=vz))
        joint = mb.Revolute(axis="y", rate=g * v / self.R + rate)
        wheel = m.body("wheel", lift, joint, mass=self.m, inertia=(self.C, self.C, self.C))
        tire = mb.RollingWheel(radius=self.R, **(self.profile.options() | options))
        contact = m.cut("contact", tire, ground, wheel)
        m.output("px", along.coordinate())
        m.output("pz", lift.coordinate())
        m.output("angle", wheel.coordinate())
        m.output("normal", contact.force("normal"))
        m.output("friction", contact.force("longitudinal"))
        m.output("demand", contact.required_friction())
        return m


@pytest.mark.parametrize(("solver", "points"), [("adams", 0), ("hybrid", 41), ("radau", 0), ("ida", 41)])
@pytest.mark.parametrize("size", SIZES)
def test_a_wheel_over_a_sine_follows_lagranges_equation(solver: str, points: int, size: float) -> None:
    """On an incline, and with the forces."""
    plane, rate = Planar(Sine(size, points), size, 0.7), np.sqrt(G / size)
    down, x, v = G * np.array((0.15, -1.0)), 0.3 * size, 0.8 * size * rate
    times = np.linspace(0.0, 8.0 / rate, 17)

    def slopes(_: float, y: Any) -> Any:
        return y[1], plane.accelerate(*y, 0.0, 0.0, down)[0]

    exact = solve_ivp(
        slopes, times[[0, -1]], (x, v), "DOP853", times, rtol=1e-12, atol=1e-13 * size, max_step=0.02 / rate
    ).y
    found = mb.simulate(plane.model(x, v, down), times[-1], solver=solver, tolerance=1e-9, interval=times[1])
    assert not [d for d in found.diagnostics if d.severity == "warning"]
    p = np.array([plane.center(own)[0] for own in exact[0]]).T
    np.testing.assert_allclose([found["px"], found["pz"]], p, atol=3e-7 * size)
    forces = [plane.accelerate(*own, 0.0, 0.0, down)[1] for own in exact.T]
    frames = [plane.center(own) for own in exact[0]]
    normal = [force @ n for force, (_, _, n, _) in zip(forces, frames, strict=True)]
    along = [force @ tau for force, (_, tau, _, _) in zip(forces, frames, strict=True)]
    np.testing.assert_allclose(found["normal"], normal, atol=1e-5 * plane.m * G)
    np.testing.assert_allclose(found["friction"], along, atol=1e-5 * plane.m * G)
    np.testing.assert_allclose(found["demand"], np.abs(np.divide(along, normal)), atol=1e-5)


@pytest.mark.parametrize("size", SIZES)
def test_a_wheel_over_a_sine_needs_the_time_of_the_quadrature(size: float) -> None:
    """(m + C / R^2) (p')^2 / 2 + m g z is constant: t is the integral of g dx over the speed of the center."""
    plane, rate = Planar(Sine(size), size), np.sqrt(G / size)
    x, v, stop = -0.5 * size, 1.8 * size * rate, 6.0 / rate
    found = mb.simulate(plane.model(x, v, np.array((0.0, -G))), stop, tolerance=1e-10)
    first, inertia = plane.center(x), plane.m + plane.C / size**2
    energy = 0.5 * inertia * (first[3] * v) ** 2 + plane.m * G * first[0][1]

    def slowness(at: float) -> float:
        p, _, _, g = plane.center(at)
        return float(g / np.sqrt(2.0 * (energy - plane.m * G * p[1]) / inertia))

    end = brentq(lambda at: plane.center(at)[0][0] - found["px"][-1], x, x + 20.0 * size, xtol=1e-14 * size)
    assert end > x + 4.0 * size
    assert quad(slowness, x, end, epsabs=0.0, epsrel=1e-12, limit=200)[0] == pytest.approx(stop, rel=1e-8)


@pytest.mark.parametrize("rates", [(0.0, 0.4), (0.3, -0.2, 0.25)])
@pytest.mark.parametrize("size", SIZES)
def test_a_wheel_on_a_base_that_turns_follows_lagranges_equation(rates: tuple[float, ...], size: float) -> None:
    plane, rate = Planar(Sine(size), size), np.sqrt(G / size)
    base = tuple(own * rate**k for k, own in enumerate(rates))
    x, v, times = 0.3 * size, 0.5 * size * rate, np.linspace(0.0, 4.0 / rate, 9)
    turn, w, dw = (np.polynomial.Polynomial(base).deriv(k) for k in range(3))

    def down(t: float) -> Any:
        return G * np.array((np.sin(turn(t)), -np.cos(turn(t))))

    def slopes(t: float, y: Any) -> Any:
        return y[1], plane.accelerate(*y, w(t), dw(t), down(t))[0]

    exact = solve_ivp(slopes, times[[0, -1]], (x, v), "DOP853", times, rtol=1e-12, atol=1e-13 * size).y
    m = plane.model(x, v, np.array((0.0, -G)), base)
    found = mb.simulate(m, times[-1], tolerance=1e-9, interval=times[1])
    assert not found.inaccurate
    c, s = np.cos(turn(times)), np.sin(turn(times))
    p = np.array([plane.center(own)[0] for own in exact[0]]).T
    np.testing.assert_allclose(found["px"], c * p[0] + s * p[1], atol=3e-7 * size)
    np.testing.assert_allclose(found["pz"], c * p[1] - s * p[0], atol=3e-7 * size)
    forces = [plane.accelerate(*y, w(t), dw(t), down(t))[1] for t, y in zip(times, exact.T, strict=True)]
    normal = [force @ plane.center(own)[2] for force, own in zip(forces, exact[0], strict=True)]
    np.testing.assert_allclose(found["normal"], normal, atol=1e-5 * plane.m * G)


class Trough:
    """A cylindrical trough of radius ``depth``, for :class:`Planar`."""

    def __init__(self, depth: float) -> None:
        self.depth = depth

    def __call__(self, x: Any) -> Slopes:
        root = np.sqrt(self.depth**2 - x * x)
        return Slopes(-root, x / root, self.depth**2 / root**3, 3.0 * self.depth**2 * x / root**5)

    def options(self) -> dict[str, Any]:
        """Return the arguments of a wheel in it."""
        end = 0.98 * self.depth
        return {"profile": f"-sqrt({self.depth!r}**2 - x*x)", "profile_interval": (-end, end)}


@pytest.mark.parametrize("size", SIZES)
def test_a_wheel_in_a_cylindrical_trough_is_a_pendulum(size: float) -> None:
    """sin(theta / 2) = k cd(w t, k^2), w^2 = g / ((D - R) (1 + C / (m R^2))), k = sin of half the start angle."""
    plane, depth, angle = Planar(Trough(3.7 * size), size, 0.8), 3.7 * size, 1.1
    w, k = np.sqrt(G / ((depth - size) * 1.8)), np.sin(0.5 * angle)
    m = plane.model(depth * np.sin(angle), 0.0, np.array((0.0, -G)))
    found = mb.simulate(m, 1.7 * 4.0 * ellipk(k * k) / w, tolerance=1e-10)
    _, cn, dn, _ = ellipj(w * found.t, k * k)
    theta = 2.0 * np.arcsin(k * cn / dn)
    np.testing.assert_allclose(found["px"], (depth - size) * np.sin(theta), atol=1e-7 * size)
    np.testing.assert_allclose(found["pz"], -(depth - size) * np.cos(theta), atol=1e-7 * size)
    np.testing.assert_allclose(found["angle"] - found["angle"][0], (depth - size) / size * (theta - angle), atol=1e-6)
    rate = 2.0 * w**2 * (np.cos(theta) - np.cos(angle))
    normal = plane.m * (G * np.cos(theta) + (depth - size) * rate)
    np.testing.assert_allclose(found["normal"], normal, rtol=1e-6, atol=1e-6 * plane.m * G)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("points", [0, 61])
def test_rest_and_small_oscillations_in_a_trough(size: float, points: int) -> None:
    """At the bottom of a trough of curvature kappa: w^2 = g kappa / ((1 - kappa R) (1 + C / (m R^2)))."""
    profile = Sine(size, points)
    plane, bottom = Planar(profile, size, 0.6), 0.75 * WAVE * size
    if points:
        bottom = brentq(lambda x: profile(x).h1, 0.7 * WAVE * size, 0.8 * WAVE * size, xtol=1e-15 * size)
    kappa = profile(bottom).h2
    w = np.sqrt(G * kappa / ((1.0 - kappa * size) * 1.6))
    m = plane.model(bottom + 0.2 * size, 0.0, np.array((0.0, -G)))
    at_rest = mb.equilibrium(m)
    assert at_rest.outputs["px"] == pytest.approx(bottom, rel=1e-9)
    assert at_rest.stability == "undamped"
    values = at_rest.spectrum.values
    np.testing.assert_allclose(values.imag, [w], rtol=1e-8)
    np.testing.assert_allclose(values.real, 0.0, atol=1e-9 * w)
    every = np.linalg.eigvals(at_rest.state_space.A)  # two independent positions, one independent rate
    assert every.shape == (3,)
    np.testing.assert_allclose(np.sort(every.imag), (-w, 0.0, w), rtol=1e-6, atol=1e-7 * w)
    found = mb.check(m)
    assert (found.freedom, found.position_freedom) == (1, 2)
    assert "1 degree of freedom (2 of positions: some constraints are nonholonomic)" in format_findings(found)


class Coin:
    """A wheel of any attitude on a sine. Coordinates: x and y of the contact, heading, lean, rotation about the axle.

    Newton and Euler's equations about the center with the force at the contact, in the axes of the profile. State:
    coordinates (5), angular velocity (3). The rates of the coordinates follow from the angular velocity w and from the
    velocity -w x r of the center, with r from the center to the contact.
    """

    def __init__(self, profile: Any, R: float, crown: float) -> None:
        self.profile, self.R, self.c, self.m = profile, R, crown * R, 2.0 * R**3
        self.C, self.A = 0.6 * self.m * R**2, 0.35 * self.m * R**2

    def frame(self, q: Any) -> Any:
        """Return the normal, the heading t, the axle e, r and the center, analytic in the coordinates."""
        x, y, heading, lean, _ = q
        h, h1, _, _ = self.profile(x)
        sigma, zero = np.sqrt(1.0 + h1 * h1), 0.0 * x
        tau, n, across = np.array((1.0 + zero, zero, h1)) / sigma, np.array((-h1, zero, 1.0 + zero)) / sigma, AXES[1]
        t = np.cos(heading) * tau + np.sin(heading) * across
        e = np.cos(lean) * np.cross(n, t) + np.sin(lean) * n
        r = (self.R - self.c) * np.cross(e, t) - self.c * n
        return n, t, e, r, np.array((x, y, h)) - r

    def rates(self, q: Any, w: Any) -> tuple[Any, Any]:
        """Return the rates of the coordinates, and that of r."""
        n, t, e, r, _ = self.frame(q)
        _, h1, h2, _ = self.profile(q[0])
        turning = np.column_stack((-h2 / (1.0 + h1 * h1) * AXES[1], np.zeros(3), n, t, e))
        step = 1e-30
        steps = [self.frame(q + 1j * step * unit) for unit in np.eye(5)]
        moving = np.column_stack([own[4].imag / step for own in steps])
        found, _, rank, _ = np.linalg.lstsq(np.vstack((turning, moving / self.R)), np.r_[w, -np.cross(w, r) / self.R])
        assert rank == 5
        return found, np.column_stack([own[3].imag / step for own in steps]) @ found

    def slopes(self, _: float, state: Any, down: Any) -> Any:
        """Return the derivative of the state."""
        q, w = state[:5], state[5:]
        return np.concatenate((self.rates(q, w)[0], self.accelerate(q, w, down)[0]))

    def accelerate(self, q: Any, w: Any, down: Any) -> tuple[Any, Any]:
        """Return the angular acceleration and the force at the contact."""
        _, _, e, r, _ = self.frame(q)
        dr = self.rates(q, w)[1]
        inertia = self.A * np.eye(3) + (self.C - self.A) * np.outer(e, e)
        K = inertia + self.m * (r @ r * np.eye(3) - np.outer(r, r))
        drive = np.cross(r, self.m * (-np.cross(w, dr) - down)) - np.cross(w, inertia @ w)
        dw = np.linalg.solve(K, drive)
        return dw, self.m * (-np.cross(dw, r) - np.cross(w, dr) - down)


AXES = np.eye(3)


@pytest.mark.parametrize(("size", "crown", "solver"), [(1e-3, 0.0, "radau"), (1.0, 0.3, "adams"), (1e3, 0.2, "ida")])
def test_a_coin_on_corrugated_ground_follows_newton_and_euler(size: float, crown: float, solver: str) -> None:
    """In any direction of the profile, of its normal, of gravity, and of the frame of the wheel."""
    coin, rate, rng = Coin(Sine(size), size, crown), np.sqrt(G / size), np.random.default_rng(4)
    space, own = Rotation.random(random_state=rng), Rotation.random(random_state=rng)
    q, w = np.array((0.4 * size, 0.1 * size, 0.7, 0.3, 0.0)), rate * np.array((-0.4, 1.6, 0.3))
    down, times = G * np.array((0.1, 0.2, -1.0)), np.linspace(0.0, 4.0 / rate, 9)
    exact = solve_ivp(
        coin.slopes, times[[0, -1]], np.r_[q, w], "DOP853", times, args=(down,), rtol=1e-11, atol=1e-12 * size
    ).y.T
    assert np.ptp(exact[:, 0]) > 2.0 * size
    assert np.ptp(exact[:, 3]) > 0.3
    _, t, e, r, center = coin.frame(q)
    wheel = space * Rotation.from_matrix(np.column_stack((t, e, np.cross(t, e)))) * own
    start = space.apply(center)
    v, turning = space.apply(-np.cross(w, r)), wheel.inv().apply(space.apply(w))
    inertia = own.as_matrix().T @ np.diag((coin.A, coin.C, coin.A)) @ own.as_matrix()
    m = mb.Mechanism(gravity=space.apply(down))
    free = mb.Floating(start=(*start, *wheel.as_quat(scalar_first=True)), rate=(*v, *turning))
    body = m.body("coin", m.ground, free, mass=coin.m, inertia=inertia)
    tire = mb.RollingWheel(
        radius=size,
        crown_radius=crown * size,
        normal=space.apply(AXES[2]),
        profile_axis=space.apply(AXES[0]),
        rotation_b=own.inv(),
        **coin.profile.options(),
    )
    contact = m.cut("contact", tire, m.ground, body)
    for axis in "xyz":
        m.output(axis, body.position(axis))
        m.output(f"F{axis}", contact.joint_force(axis))
    found = mb.simulate(m, times[-1], solver=solver, tolerance=1e-9, interval=times[1])
    assert not found.inaccurate
    loads = [coin.accelerate(state[:5], state[5:], down)[1] for state in exact]
    normal = np.array([load @ coin.frame(state[:5])[0] for load, state in zip(loads, exact, strict=True)])
    warned = [d for d in found.diagnostics if d.severity == "warning"]
    assert [d.code for d in warned] == ["lifting-wheel"]
    assert warned[0].time == pytest.approx(times[normal < 0.0][0])
    centers = [space.apply(coin.frame(state[:5])[4]) for state in exact]
    np.testing.assert_allclose(np.array([found[axis] for axis in "xyz"]).T, centers, atol=1e-6 * size)
    found = np.array([found[f"F{axis}"] for axis in "xyz"]).T
    np.testing.assert_allclose(found, space.apply(loads), atol=1e-5 * coin.m * G)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("grip", ["both", "longitudinal", "lateral"])
def test_rows_on_profiles_are_derivatives_at_random_states(size: float, grip: str) -> None:
    """Also where the wheel is above or below its profile, and body a moves."""
    rng = np.random.default_rng(11)
    for profile in (Sine(size), Sine(size, 17)):
        m = mb.Mechanism()
        bodies = [m.ground]
        for k in range(2):
            turn = Rotation.from_rotvec(0.5 * rng.normal(size=3))
            place = size * (0.3 * rng.normal(size=3) + k * AXES[2])
            joint = mb.Floating(start=(*place, *turn.as_quat(scalar_first=True)))
            bodies.append(m.body(f"b{k}", bodies[-1], joint, mass=1.0, inertia=np.eye(3) * size**2))
        places = {"at_a": 0.1 * size * rng.normal(size=3), "at_b": 0.1 * size * rng.normal(size=3)}
        joint = mb.RollingWheel(radius=size, crown_radius=0.3 * size, grip=grip, **places, **profile.options())
        m.cut("wheel", joint, bodies[1], bodies[2])
        compiled = CompiledMechanism(m)
        assert compiled.system.holonomic.tolist() == [0]
        for _ in range(4):
            at = random_state(compiled, rng, 0.2 * size)
            for found in constraint_rates(compiled, at):
                assert found.size < 1e-8 + 10.0 * found.uncertainty, found


def leaning(lean: float, x: float, size: float) -> mb.Mechanism:
    """A thin disk that heads along a parabola with a radius of curvature of 1.11 R, its axle held at ``lean`` above the
    horizontal.
    """
    m = mb.Mechanism(gravity=(0.0, 0.0, -G))
    along = m.body("along", m.ground, mb.Translational(axis="x", start=x))
    lift = m.body("lift", along, mb.Translational(axis="z", start=size * np.cos(lean) + 0.45 / size * x * x))
    axle = (0.0, np.cos(lean), np.sin(lean))
    wheel = m.body("wheel", lift, mb.Revolute(axis=axle), mass=1.0, inertia=(size**2,) * 3)
    options = {"profile": f"{0.45 / size!r} * x * x", "profile_interval": (-3.0 * size, 3.0 * size)}
    tire = mb.RollingWheel(radius=size, axis=axle, grip="longitudinal", **options)
    m.cut("contact", tire, m.ground, wheel)
    m.output("x", along.coordinate())
    return m


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("lean", [0.0, 0.7])
def test_the_depth_of_a_profile_in_a_wheel_is_that_of_points_on_its_rim(size: float, lean: float) -> None:
    compiled, found = CompiledMechanism(leaning(lean, 0.0, size)), np.zeros(3)
    part = np.linspace(0.0, 2.0 * np.pi, 20_001)
    for x, z in ((0.02, 0.7), (0.3, 0.9), (-1.5, 1.6), (0.4, 1.8)):
        compiled.system.fill_position(0.0, size * np.array((x, z, 0.0)), compiled.system.allocate_terms())
        locate_contact(0, compiled.kernel_data, found)
        axes = np.array((1.0, 0.0)), np.array((0.0, np.cos(lean)))
        rim = size * (np.array((x, z)) + np.outer(np.cos(part), axes[0]) + np.outer(np.sin(part), axes[1]))
        depth = (0.45 / size * rim[:, 0] ** 2 - rim[:, 1]) / np.sqrt(1.0 + (0.9 / size * rim[:, 0]) ** 2)
        depth[rim[:, 1] > z * size] = -np.inf  # the profile limits the lower half of the rim
        assert found[2] == pytest.approx(depth.max(), rel=1e-3)
        assert found[1] == pytest.approx(rim[np.argmax(depth), 0], abs=0.02 * size)


@pytest.mark.parametrize(("lean", "touches"), [(0.0, False), (0.3, False), (0.7, True)])
@pytest.mark.parametrize("size", SIZES)
def test_a_wheel_that_touches_two_places_is_reported(lean: float, touches: bool, size: float) -> None:
    """The outline of a disk that leans has the radius of curvature R / cos(lean) at its lowest point."""
    assert (0.9 / np.cos(lean) > 1.0) == touches
    result = mb.simulate(leaning(lean, 0.5 * size, size), 3.0 * np.sqrt(size / G), tolerance=1e-8)
    found = [d.code for d in result.diagnostics if d.severity == "warning"]
    assert ("second-contact" in found) == touches
    assert touches or (not result.failure and found == [] and result["x"].min() < -0.1 * size)


def flat(R: float, v: float, **options: Any) -> mb.Mechanism:
    """A wheel that rolls along x from x = 0 on a horizontal profile."""

    class Flat:
        def __call__(self, x: float) -> Slopes:
            return Slopes(0.0, 0.0, 0.0, 0.0)

        def options(self) -> dict[str, Any]:
            return options

    return Planar(Flat(), R).model(0.0, v, np.array((0.0, -G)))


@pytest.mark.parametrize("size", SIZES)
def test_a_wheel_that_leaves_its_profile_is_reported(size: float) -> None:
    ends = (-size, 2.0 * size)
    points = np.array(ends), np.zeros(2)
    for options, leaves in (
        ({"profile": "0.0", "profile_interval": ends}, True),
        ({"profile": mb.Table(*points)}, True),
        ({"profile": mb.Table(*points, beyond="hold")}, False),
        ({"profile": mb.Table(*points, beyond="periodic")}, False),
        ({"profile": mb.Table(*points, beyond="periodic"), "profile_interval": ends}, True),
    ):
        result = mb.simulate(flat(size, size, **options), 3.0, interval=0.5, tolerance=1e-8)
        found = [d for d in result.diagnostics if d.severity == "warning"]
        assert [(d.code, d.time) for d in found] == ([("profile-end", pytest.approx(2.5))] if leaves else [])
        assert result["px"][-1] == pytest.approx(3.0 * size, rel=1e-8)


@pytest.mark.parametrize("size", SIZES)
def test_the_smallest_radius_of_a_trough_limits_the_wheel(size: float) -> None:
    """Of a sin(k x) it is 1 / (a k^2), at three quarters of the wave; of a parabola x^2 / (2 D) it is D, at zero."""
    sine = Sine(size)
    limit, m = 1.0 / (sine.a * sine.k**2), mb.Mechanism()
    body = m.body("wheel", m.ground, mb.Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    points = Sine(size, 401).table
    for options, radius, place, accuracy in (
        (sine.options() | {"profile_interval": (0.0, WAVE * size)}, limit, 0.75 * WAVE * size, 1e-9),
        ({"profile": points}, limit, 0.75 * WAVE * size, 1e-3),
        ({"profile": f"x * x / {4.0 * size!r}", "profile_interval": (-size, 5.0 * size)}, 2.0 * size, 0.0, 1e-9),
    ):
        m.cut("smaller", mb.RollingWheel(radius=(1.0 - accuracy) * radius, **options), m.ground, body)
        m = mb.Mechanism()
        body = m.body("wheel", m.ground, mb.Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0))
        with pytest.raises(UserError) as refused:
            m.cut("larger", mb.RollingWheel(radius=(1.0 + accuracy) * radius, **options), m.ground, body)
        found = [float(part.split(" m")[0]) for part in re.split("curvature of |x = ", str(refused.value))[1:]]
        assert found == [pytest.approx(radius, rel=1e-3), pytest.approx(place, rel=2e-3, abs=2e-3 * size)]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"profile": 3.0}, "profile of cut 'w' is 3.0; allowed: a Table, a function or an expression"),
        ({"profile": mb.Polynomial((0.0, 1.0))}, "allowed: a Table, a function or an expression"),
        ({"profile": mb.Table((0, 1, 2), (0, 1, 0), kind="linear")}, "its slope jumps"),
        ({"profile": mb.Table((0, 1, 2), (0, np.nan, 0))}, "allowed: finite numbers"),
        ({"profile": "0.1 * sin(y)", "profile_interval": (0, 1)}, "'y' is not known"),
        ({"profile": "0.1 * sin(x)"}, "profile of cut 'w' is a function; give profile_interval"),
        ({"profile": "0.1 * sin(x)", "profile_interval": (1.0, 0.0)}, "profile_interval of cut 'w' is .1.0, 0.0."),
        ({"profile": "0.1 * sin(x)", "profile_interval": (0.0, 1e6)}, "allowed: a length of at most 2000 times"),
        ({"profile": "0.1 * sin(x)", "profile_interval": (0, 1), "profile_width": 0.0}, "profile_width of cut 'w'"),
        ({"profile": "0.1 * sin(x)", "profile_interval": (0, 1), "profile_axis": "z"}, "profile_axis of cut 'w' is"),
        ({"profile": mb.Table((0, 1, 2), (0, 0, 0)), "profile_interval": (0, 3)}, "are between 0 and 2 m"),
        ({"profile": "log(x)", "profile_interval": (-1, 1)}, "profile of cut 'w' is nan at x = -1 m"),
        ({"profile": "-sqrt(abs(x - 0.01))", "profile_interval": (-1, 1)}, "is not smooth near x = 0.0"),
        ({"profile": "-abs(x - 0.013)", "profile_interval": (-1, 1)}, "is not smooth near x = 0.0"),
        ({"profile": "x * x if x > 0.013 else 0.0", "profile_interval": (-1, 1)}, "is not smooth near x = 0.0"),
        ({"profile": "1e-4 * sin(1000 * x)", "profile_interval": (-1, 1)}, "is not smooth near x = -1 m"),
        ({"profile": "tan(x)", "profile_interval": (-2, 2)}, "is not smooth near x = -1.5"),
    ],
)
def test_profiles_that_no_wheel_can_follow_are_refused(options: dict[str, Any], text: str) -> None:
    m = mb.Mechanism()
    body = m.body("wheel", m.ground, mb.Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    with pytest.raises(UserError, match=text):
        m.cut("w", mb.RollingWheel(radius=0.5, **options), m.ground, body)


def test_a_wheel_starts_on_its_profile_from_above_and_below() -> None:
    """Several radii away the wheel moves vertically first; the contact is then exact."""
    sine = Sine(1.0)
    plane = Planar(sine, 1.0)
    for height in (-4.0, -0.5, 0.9, 1.4, 2.5, 6.0):
        m = plane.model(0.4, 0.0, np.array((0.0, -G)))
        m.bodies[2].joint.__dict__["start"] = height
        found = mb.simulate(m, 0.01, interval=0.01)
        x = brentq(lambda at, to=found["px"][0]: plane.center(at)[0][0] - to, -4.0, 4.0, xtol=1e-14)
        assert found["pz"][0] == pytest.approx(plane.center(x)[0][1], abs=1e-9)


class Gutter(Sine):
    """z = 0.3 x^2 / R, along whose bottom a wheel rolls."""

    def __call__(self, x: Any) -> Slopes:
        b = HEIGHT / self.R
        return Slopes(b * x * x, 2.0 * b * x, 2.0 * b + 0.0 * x, 0.0 * x)

    def options(self) -> dict[str, Any]:
        """Return the arguments of a wheel in it."""
        return {"profile": f"{HEIGHT / self.R!r} * x * x", "profile_interval": (-3.0 * self.R, 3.0 * self.R)}


@pytest.mark.parametrize(
    ("size", "froude", "crown"), [(1.0, 0.0, 0.2), (1e-3, 1.0, 0.2), (1e3, 0.4, 0.0), (1.0, 2.0, 0.5)]
)
def test_the_linear_motion_of_a_wheel_along_a_gutter(size: float, froude: float, crown: float) -> None:
    """Eigenvalues about steady rolling are those of Newton and Euler's equations, differentiated by differences."""
    coin, rate = Coin(Gutter(size), size, crown), np.sqrt(G / size)
    spin, q, down = froude * rate, np.array((0.0, 0.0, 0.5 * np.pi, 0.0, 0.0)), np.array((0.0, 0.0, -G))
    state, unit = np.r_[q, spin * coin.frame(q)[2]], np.repeat((size, 1.0, rate), (2, 3, 3))
    A = np.empty((8, 8))
    for k, way in enumerate(1e-3 * np.diag(unit)):
        far, near = (coin.slopes(0.0, state + n * way, down) - coin.slopes(0.0, state - n * way, down) for n in (2, 1))
        A[:, k] = (8.0 * near - far) / 12e-3 / unit
    expected = np.linalg.eigvals(A) / rate
    m = mb.Mechanism(gravity=down)
    along = m.body("x", m.ground, mb.Translational(axis="x"))
    across = m.body("y", along, mb.Translational(axis="y", rate=spin * size))
    lift = m.body("z", across, mb.Translational(axis="z", start=size))
    yaw = m.body("yaw", lift, mb.Revolute(axis="z", start=0.5 * np.pi))
    lean = m.body("lean", yaw, mb.Revolute(axis="x"))
    disk = m.body("disk", lean, mb.Revolute(axis="y"), mass=coin.m, inertia=(coin.A, coin.C, coin.A))
    tire = mb.RollingWheel(radius=size, crown_radius=crown * size, **coin.profile.options())
    m.cut("contact", tire, m.ground, disk)
    found = np.linalg.eigvals(mb.equilibrium(m).state_space.A) / rate
    assert found.shape == (8,)
    found, expected = (np.sort_complex(np.round(own[np.abs(own) > 0.01], 7)) for own in (found, expected))
    assert len(expected) >= 2
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("solver", ["adams", "radau"])
def test_a_wheel_on_a_cart_that_moves_freely_keeps_momentum_and_energy(size: float, solver: str) -> None:
    """The cart is a body with a trough, which the wheel pushes to and fro."""
    mass, rate = 3.0 * size**3, np.sqrt(G / size)
    m = mb.Mechanism(gravity=(0.0, 0.0, -G))
    cart = m.body("cart", m.ground, mb.Translational(axis="x"), mass=mass)
    along = m.body("along", cart, mb.Translational(axis="x", start=1.2 * size))
    lift = m.body("lift", along, mb.Translational(axis="z", start=1.2 * size))
    wheel = m.body("wheel", lift, mb.Revolute(axis="y"), mass=mass, inertia=(mass * size**2,) * 3)
    m.cut("contact", mb.RollingWheel(radius=size, **Gutter(size).options()), cart, wheel)
    m.output("cart", cart.velocity("x"))
    m.output("wheel", wheel.velocity("x"))
    m.output("energy", m.energy)
    result = mb.simulate(m, 20.0 / rate, solver=solver, tolerance=1e-8)
    assert np.abs(result["cart"]).max() > 0.1 * size * rate
    assert np.abs(result["cart"] + result["wheel"]).max() < 1e-6 * size * rate
    assert np.ptp(result["energy"]) < 1e-6 * mass * G * size
    assert not result.inaccurate


@pytest.mark.parametrize("part", [0.999, 1.001])
def test_a_wheel_that_would_slip_on_a_slope_is_reported(part: float) -> None:
    """Down a straight slope the friction is weight times sin(slope) / (1 + m R^2 / C)."""
    slope, hoop = 0.4, 0.7
    needed = np.tan(slope) * hoop / (1.0 + hoop)
    plane = Planar(lambda x: Slopes(-np.tan(slope) * x, -np.tan(slope), 0.0, 0.0), 0.5, hoop)
    table = mb.Table((-5.0, 20.0), (5.0 * np.tan(slope), -20.0 * np.tan(slope)))
    plane.profile.options = lambda: {"profile": table}
    result = mb.simulate(plane.model(0.0, 0.0, np.array((0.0, -G)), friction=part * needed), 1.0, tolerance=1e-8)
    np.testing.assert_allclose(result["demand"], needed, rtol=1e-6)
    found = [d.code for d in result.diagnostics if d.severity == "warning"]
    assert found == (["slipping-wheel"] if part < 1.0 else [])


def test_pictures_show_the_profile_where_its_wheel_comes() -> None:
    sine = Sine(0.5)
    m = Planar(sine, 0.5).model(0.4, 0.0, np.array((0.0, -G)))
    compiled = CompiledMechanism(m)
    poses = tuple(np.array([own]) for own in compiled.poses(0.0, compiled.assembly.start_positions()))
    shapes = list(profile_shapes(m, poses))
    assert {body.index for body, _ in shapes} == {0}
    at = np.array([shape.at for _, shape in shapes])
    center = Planar(sine, 0.5).center(0.4)[0]
    assert at[:, 0].min() < center[0] - 1.0
    assert at[:, 0].max() > center[0] + 1.0
    np.testing.assert_allclose(at[:, 2], sine(at[:, 0]).h, atol=1e-3)
    assert not list(profile_shapes(m, None))
