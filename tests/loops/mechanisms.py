"""Mechanisms with closed loops, by name: singular ones with their exact motion, ones beside them, redundant ones.

Every function returns a :class:`Case`. Where all cranks of a linkage stay parallel its motion is that of a few angles;
``exact`` integrates their equation and gives the compiled mechanism's coordinates, through every singular position.
``scale`` makes the same mechanism of another size: what is returned moves alike, in its own lengths, masses and times.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from math import atan2, cos, pi, radians, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from mbfmu.mechanics import (
    Harmonic,
    JointForce,
    JointSpring,
    Mechanism,
    Polynomial,
    Revolute,
    RevoluteCutJoint,
    RunUp,
    SphericalCutJoint,
    Spring,
    Translational,
    rod,
)

G = 9.81
Exact = Callable[..., tuple[Any, Any]]  # (times (k,), nudge=0.0) -> q (k, nq), v (k, n); see :func:`turning`


class Case(NamedTuple):
    """A mechanism, its exact motion if one is known, and how long it is worth to be watched, s."""

    mechanism: Mechanism
    exact: Exact | None
    stop_time: float


class Scale(NamedTuple):
    """What lengths, masses and times are multiplied by."""

    lengths: float = 1.0
    masses: float = 1.0
    times: float = 1.0

    @property
    def gravity(self) -> float:
        """m/s^2."""
        return G * self.lengths / self.times**2

    @property
    def torque(self) -> float:
        """Factor of energies and torques."""
        return self.masses * self.lengths**2 / self.times**2


UNSCALED = Scale()


def _vertical(scale: Scale) -> Mechanism:
    return Mechanism(gravity=(0.0, -scale.gravity, 0.0))


def _finish(m: Mechanism) -> Mechanism:
    """Publish the energy, as every mechanism here does."""
    m.output("energy", m.energy, "kinetic and potential energy")
    return m


def turning(
    inertia: Callable[[float], tuple[float, float]],
    slope: Callable[[float], float],
    start: tuple[float, float],
    embed: Callable[[Any, Any], tuple[Any, Any]],
) -> Exact:
    """Exact motion of one angle: m theta'' + m' theta'^2 / 2 + V' = 0; ``inertia``: (m, m'), ``slope``: V'.

    What is returned takes times (k,) and a ``nudge``, of the angle (rad) and of the rate (in what gravity gives) at
    every one of the times, to see how errors grow.
    """
    pace = sqrt(max(abs(slope(a)) / inertia(a)[0] for a in np.linspace(0.0, 2.0 * pi, 64)))

    def right(_: float, y: Any) -> list[float]:
        m, dm = inertia(y[0])
        return [y[1], -(0.5 * dm * y[1] ** 2 + slope(y[0])) / m]

    def exact(times: Any, nudge: float = 0.0) -> tuple[Any, Any]:
        y = _followed(right, times, np.array(start), nudge * np.array((1.0, pace)))
        return embed(y[:, 0], y[:, 1])

    return exact


def _followed(right: Any, times: Any, start: Any, nudge: Any) -> Any:
    """Solution (k, 2 n) at the times; with a nudge (2 n,) it is pushed by that, either way, at every one of them."""
    options: dict[str, Any] = {"method": "DOP853", "rtol": 2.3e-14, "atol": 1e-15}
    if not np.any(nudge):
        return solve_ivp(right, (float(times[0]), float(times[-1])), start, t_eval=times, **options).y.T
    rows, rng = [start], np.random.default_rng(len(times))
    for span in pairwise(times):
        pushed = rows[-1] + nudge * rng.choice((-1.0, 1.0), len(start))
        rows.append(solve_ivp(right, span, pushed, **options).y[:, -1])
    return np.array(rows)


def swinging(inertia: float, weight: float, start: tuple[float, float], embed: Any) -> Exact:
    """The pendulum: inertia theta'' = -weight cos theta."""
    return turning(lambda _: (inertia, 0.0), lambda a: weight * cos(a), start, embed)


def _columns(*signs: float) -> Callable[[Any, Any], tuple[Any, Any]]:
    """Coordinates that are plus or minus one angle."""
    return lambda a, b: (np.outer(a, signs), np.outer(b, signs))


def four_bar(
    lengths: tuple[float, float, float, float],
    masses: tuple[float, float, float],
    start: float,
    rate: float,
    scale: Scale,
    guess: tuple[float, float] | None = None,
) -> Mechanism:
    """Crank, coupler, rocker, ground; ``start``, ``rate`` of the crank, ``guess``: coupler and rocker, absolute."""
    a, b, c, d = (x * scale.lengths for x in lengths)
    ma, mb, mc = (x * scale.masses for x in masses)
    along, up = guess or closed_above(lengths, start)
    m = _vertical(scale)
    joint = Revolute(start=start, rate=rate / scale.times, fixed=True)
    crank = m.body("crank", m.ground, joint, **rod(mass=ma, length=a))
    pin = Revolute(at=(a, 0.0, 0.0), start=along - start)
    coupler = m.body("coupler", crank, pin, **rod(mass=mb, length=b))
    rocker = m.body("rocker", coupler, Revolute(at=(b, 0.0, 0.0), start=up - along), **rod(mass=mc, length=-c))
    m.cut("pivot", RevoluteCutJoint(at_a=(-c, 0.0, 0.0), at_b=(d, 0.0, 0.0)), rocker, m.ground)
    return _finish(m)


def closed_above(lengths: tuple[float, float, float, float], crank: float) -> tuple[float, float]:
    """Absolute angles of coupler and rocker, with the pin of both to the left of the way from crank pin to pivot."""
    a, b, c, d = lengths
    x, y = d - a * cos(crank), -a * sin(crank)
    reach = x * x + y * y
    along = atan2(y, x) + np.arccos(np.clip((b * b + reach - c * c) / (2.0 * b * sqrt(reach)), -1.0, 1.0))
    return along, atan2(b * sin(along) - y, b * cos(along) - x)


def parallelogram(eps: float = 0.0, *, start: float = 10.0, scale: Scale = UNSCALED) -> Case:
    """The four-bar 1 / 3 / 1 + eps / 3 of the project, released at ``start`` degrees; exact where eps is zero."""
    angle, masses = radians(start), (8.019, 24.057, 8.019)
    m = four_bar((1.0, 3.0, 1.0 + eps, 3.0), masses, angle, 0.0, scale, (0.0, angle))
    bars = masses[0] + masses[2]
    inertia, weight = bars / 3.0 + masses[1], 0.5 * bars + masses[1]
    exact = swinging(inertia, weight * G / scale.times**2, (angle, 0.0), _columns(1.0, -1.0, 1.0))
    return Case(m, exact if eps == 0.0 else None, 10.0 * scale.times)


def grashof(eps: float = 0.0, *, scale: Scale = UNSCALED) -> Case:
    """Crank 1, coupler 2.5, rocker 2, ground 3.5 + eps: folds flat at eps = 0, passes close to that at others."""
    m = four_bar((1.0, 2.5, 2.0, 3.5 + eps), (1.0, 0.5, 3.0), radians(120.0), 4.0, scale)
    return Case(m, None, 2.0 * scale.times)


def three_cranks(*, start: float = -20.0, rate: float = 0.0, eps: float = 0.0, scale: Scale = UNSCALED) -> Case:
    """Three equal parallel cranks on one coupler, one of them redundant; from -20 degrees they stay off the horizontal.

    ``start`` in degrees, ``rate`` in rad/s; ``eps`` lengthens all cranks and so changes nothing but the numbers.
    """
    l, w = (1.0 + eps) * scale.lengths, scale.lengths
    angle, speed = radians(start), rate / scale.times
    masses = np.array((1.0, 2.0, 0.7, 1.5)) * scale.masses  # crank 1, coupler, cranks 2 and 3
    m = _vertical(scale)
    first = m.body("crank1", m.ground, Revolute(start=angle, rate=speed, fixed=True), **rod(mass=masses[0], length=l))
    pin = Revolute(at=(l, 0.0, 0.0), start=-angle, rate=-speed)
    coupler = m.body("coupler", first, pin, **rod(mass=masses[1], length=2.0 * w))
    for i in (2, 3):
        foot = ((i - 1.0) * w, 0.0, 0.0)
        crank = m.body(
            f"crank{i}", m.ground, Revolute(at=foot, start=angle, rate=speed), **rod(mass=masses[i], length=l)
        )
        m.cut(f"pin{i}", RevoluteCutJoint(at_a=(l, 0.0, 0.0), at_b=foot), crank, coupler)
    bars = masses[0] + masses[2] + masses[3]
    inertia, weight = (bars / 3.0 + masses[1]) * l * l, (0.5 * bars + masses[1]) * scale.gravity * l
    return Case(
        _finish(m), swinging(inertia, weight, (angle, speed), _columns(1.0, -1.0, 1.0, 1.0)), 10.0 * scale.times
    )


def table(*, start: float = -20.0, rate: float = 0.0, scale: Scale = UNSCALED) -> Case:
    """A table on four equal cranks, three of them by ball joints: six rows of rank four."""
    l, angle, speed = scale.lengths, radians(start), rate / scale.times
    masses = np.array((1.0, 4.0, 0.8, 1.2, 0.6)) * scale.masses  # crank 1, table, cranks 2 to 4
    feet = [(0.0, 0.0, 0.0), (1.5 * l, 0.0, 0.0), (0.0, 0.0, 0.8 * l), (1.5 * l, 0.0, 0.8 * l)]
    m = _vertical(scale)
    first = m.body("crank1", m.ground, Revolute(start=angle, rate=speed, fixed=True), **rod(mass=masses[0], length=l))
    top = m.body(
        "table",
        first,
        Revolute(at=(l, 0.0, 0.0), start=-angle, rate=-speed),
        mass=masses[1],
        com=(0.7 * l, 0.1 * l, 0.4 * l),
        inertia=tuple(masses[1] * l * l * np.array((0.1, 0.3, 0.25))),
    )
    for i in (2, 3, 4):
        foot = feet[i - 1]
        crank = m.body(
            f"crank{i}", m.ground, Revolute(at=foot, start=angle, rate=speed), **rod(mass=masses[i], length=l)
        )
        m.cut(f"ball{i}", SphericalCutJoint(at_a=(l, 0.0, 0.0), at_b=foot), crank, top)
    bars = masses.sum() - masses[1]
    inertia, weight = (bars / 3.0 + masses[1]) * l * l, (0.5 * bars + masses[1]) * scale.gravity * l
    return Case(
        _finish(m), swinging(inertia, weight, (angle, speed), _columns(1.0, -1.0, 1.0, 1.0, 1.0)), 10.0 * scale.times
    )


def ladder(loops: int, *, start: Any = -60.0, rate: Any = 0.0, scale: Scale = UNSCALED) -> Case:
    """A rope ladder of parallelograms below each other, each storey with an angle of its own; all rungs stay level.

    ``start`` (degrees) and ``rate`` (rad/s) of the storeys, one number or one each.
    """
    l, side, rung = scale.lengths, 0.5 * scale.masses, 0.8 * scale.masses
    angles = radians(1.0) * np.broadcast_to(np.asarray(start, float), loops)
    rates = np.broadcast_to(np.asarray(rate, float), loops) / scale.times
    m = _vertical(scale)
    above, corner = m.ground, (2.0 * l, 0.0, 0.0)
    for k in range(loops):
        angle, speed = angles[k], rates[k]
        left = m.body(f"left{k}", above, Revolute(start=angle, rate=speed, fixed=True), **rod(mass=side, length=l))
        pin = Revolute(at=(l, 0.0, 0.0), start=-angle, rate=-speed)
        here = m.body(f"rung{k}", left, pin, **rod(mass=rung, length=2.0 * l))
        right = m.body(f"right{k}", here, Revolute(at=corner, start=angle, rate=speed), **rod(mass=side, length=-l))
        m.cut(f"pivot{k}", RevoluteCutJoint(at_a=(-l, 0.0, 0.0), at_b=corner), right, above)
        above = here

    def embed(a: Any, b: Any) -> tuple[Any, Any]:
        return tuple(np.stack((x, -x, x), axis=2).reshape(len(x), -1) for x in (a, b))  # type: ignore[return-value]

    exact = hanging(loops, l, 2.0 * side, rung, scale.gravity, (angles, rates), embed)
    return Case(_finish(m), exact, 2.0 * scale.times)


def hanging(n: int, l: float, side: float, rung: float, g: float, start: Any, embed: Any) -> Exact:
    """Exact motion of n storeys of length l: M_ij = w_ij l^2 cos(a_i - a_j), as of a pendulum of n links.

    ``side``: mass of both sides of a storey, uniform rods; ``rung``: of its rung, which does not turn.
    """
    ends = np.tril(np.ones((n, n)))  # how the speed of link j moves the end of link k
    middles = ends - 0.5 * np.eye(n)
    w = l * l * (rung * ends.T @ ends + side * middles.T @ middles)
    own = side * l * l / 12.0 * np.eye(n)
    weight = g * l * (rung * ends + side * middles).sum(axis=0)

    def right(_: float, y: Any) -> Any:
        a, b = y[:n], y[n:]
        apart = a[:, None] - a
        return np.r_[b, np.linalg.solve(w * np.cos(apart) + own, -(w * np.sin(apart)) @ b**2 - weight * np.cos(a))]

    def exact(times: Any, nudge: float = 0.0) -> tuple[Any, Any]:
        off = nudge * np.r_[np.ones(n), np.full(n, sqrt(g / l))]
        y = _followed(right, times, np.concatenate(start), off)
        return embed(y[:, :n], y[:, n:])

    return exact


def double_parallelogram(*, start: Any = (-60.0, -30.0), rate: Any = 0.0, scale: Scale = UNSCALED) -> Case:
    """Two parallelograms, the second one hung on the coupler of the first."""
    return ladder(2, start=start, rate=rate, scale=scale)._replace(stop_time=5.0 * scale.times)


def n_four_bar(
    loops: int = 2, *, grounded: bool = False, longer: Mapping[int, float] | None = None, scale: Scale = UNSCALED
) -> Case:
    """N four-bars side by side, all links 1 m and 1 kg, the top moved at 1 m/s (benchmark A02 of the IFToMM library).

    Horizontal, all loops are singular at once. The tree is a serial chain with a cut joint at the foot of each column,
    or, if ``grounded``, columns on the ground with a cut joint at the end of each coupler. ``longer`` maps the number
    of a coupler to the length that is added to it, in lengths; its loop then misses its singular position by that.
    """
    l, mass, angle, speed = scale.lengths, scale.masses, 0.5 * pi, -1.0 / scale.times
    m = _vertical(scale)
    upright = m.body("column0", m.ground, Revolute(start=angle, rate=speed, fixed=True), **rod(mass=mass, length=l))
    top, signs = (l, 0.0, 0.0), [1.0]
    for i in range(1, loops + 1):
        reach = l * (1.0 + (longer or {}).get(i, 0.0))
        pin, foot, end = Revolute(at=top, start=-angle, rate=-speed), (i * l, 0.0, 0.0), (reach, 0.0, 0.0)
        coupler = m.body(f"coupler{i}", upright, pin, **rod(mass=mass, length=reach))
        if grounded:
            hinge = Revolute(at=foot, start=angle, rate=speed)
            upright = m.body(f"column{i}", m.ground, hinge, **rod(mass=mass, length=l))
            m.cut(f"pin{i}", RevoluteCutJoint(at_a=end, at_b=top), coupler, upright)
        else:
            hinge = Revolute(at=end, start=angle, rate=speed)
            upright = m.body(f"column{i}", coupler, hinge, **rod(mass=mass, length=-l))
            m.cut(f"pivot{i}", RevoluteCutJoint(at_a=(-l, 0.0, 0.0), at_b=foot), upright, m.ground)
            top = (0.0, 0.0, 0.0)
        signs += [-1.0, 1.0]
    inertia, weight = ((loops + 1) / 3.0 + loops) * mass * l * l, (0.5 * (loops + 1) + loops) * mass * scale.gravity * l
    exact = None if longer else swinging(inertia, weight, (angle, speed), _columns(*signs))
    return Case(_finish(m), exact, 10.0 * scale.times)


def slider_crank(eps: float = 0.0, *, start: float = 20.0, rate: float = 6.0, scale: Scale = UNSCALED) -> Case:
    """Crank r and rod r + eps; with equal lengths the slider passes the crank's center in a singular position."""
    r, L = scale.lengths, (1.0 + eps) * scale.lengths
    crank, link, slider = np.array((1.0, 0.5, 0.8)) * scale.masses
    angle, speed = radians(start), rate / scale.times
    lean = -np.arcsin(sin(angle) * r / L)
    lean = lean if cos(angle) >= 0.0 else -pi - lean
    m = _vertical(scale)
    first = m.body("crank", m.ground, Revolute(start=angle, rate=speed, fixed=True), **rod(mass=crank, length=r))
    pin = Revolute(at=(r, 0.0, 0.0), start=lean - angle, rate=-2.0 * speed)
    second = m.body("rod", first, pin, **rod(mass=link, length=L))
    block = m.body("slider", m.ground, Translational(axis="x", start=r * cos(angle) + L * cos(lean)), mass=slider)
    m.cut("pin", RevoluteCutJoint(at_a=(L, 0.0, 0.0)), second, block)

    def inertia(a: float) -> tuple[float, float]:
        moving = 2.0 * link * r * r + 4.0 * slider * r * r
        fixed = (crank / 3.0 + link / 12.0 + 0.25 * link) * r * r
        return fixed + moving * sin(a) ** 2, moving * sin(2.0 * a)

    def slope(a: float) -> float:
        return 0.5 * (crank + link) * scale.gravity * r * cos(a)

    def embed(a: Any, b: Any) -> tuple[Any, Any]:
        q = np.column_stack((a, -2.0 * a, 2.0 * r * np.cos(a)))
        return q, np.column_stack((b, -2.0 * b, -2.0 * r * np.sin(a) * b))

    exact = turning(inertia, slope, (angle, speed), embed) if eps == 0.0 else None
    return Case(_finish(m), exact, 3.0 * scale.times)


def bricard(*, scale: Scale = UNSCALED, attitude: Any = None) -> Case:
    """Six equal rods along edges of a cube, hinges across them: of five rows on five coordinates one is redundant."""
    R = np.eye(3) if attitude is None else np.asarray(attitude, float)
    l, mass = scale.lengths, scale.masses
    corners = l * np.array([[0, 0, 0], [1, 0, 0], [1, -1, 0], [1, -1, 1], [0, -1, 1], [0, 0, 1]], float)
    rods = np.roll(corners, -1, axis=0) - corners
    m = Mechanism(gravity=R @ np.array((0.0, -scale.gravity, 0.0)))
    body = m.ground
    for i in range(5):
        axis = np.cross(rods[i - 1], rods[i]) / l**2
        first = {"rotation": R} if i == 0 else {"at": rods[i - 1]}
        inertia = mass / 12.0 * (l * l * np.eye(3) - np.outer(rods[i], rods[i]))
        body = m.body(f"rod{i}", body, Revolute(axis=axis, **first), mass=mass, com=0.5 * rods[i], inertia=inertia)
    hinge = np.cross(rods[4], rods[5]) / l**2
    frame = np.column_stack((rods[4] / l, np.cross(hinge, rods[4] / l), hinge))
    m.cut(
        "hinge",
        RevoluteCutJoint(at_a=rods[4], at_b=R @ corners[5], rotation_a=frame, rotation_b=R @ frame),
        body,
        m.ground,
    )
    return Case(_finish(m), None, 5.0 * scale.times)


# State of Andrews' squeezer after 0.03 s, IVP test set: K1 to K7 in the order of the bodies below.
SQUEEZER_END = (
    15.81077119629904,
    -15.75637105984298,
    0.04082224013073101,
    0.5244099658805304,
    -0.5347301163226948,
    1.048080741042263,
    0.5347301163226948,
)


def squeezer(*, scale: Scale = UNSCALED) -> Case:
    """Andrews' squeezer: seven bodies, three loops, a spring, a motor of constant torque (IVP test set)."""
    L, ms = scale.lengths, scale.masses
    m = Mechanism()

    def body(name: str, on: Any, at: Any, start: float, mass: float, inertia: float, com: Any) -> Any:
        joint = Revolute(at=(at[0] * L, at[1] * L, 0.0), start=start, fixed=name == "K1")
        J = inertia * ms * L * L
        return m.body(name, on, joint, mass=mass * ms, com=(com[0] * L, com[1] * L, 0.0), inertia=(J / 2, J / 2, J))

    A, B = (-0.06934, -0.00227), (-0.03635, 0.03273)
    phi = 0.222668390165885884674473185609
    k1 = body("K1", m.ground, (0.0, 0.0), -0.0617138900142764496358948458001, 0.04325, 2.194e-6, (0.00092, 0.0))
    k2 = body("K2", k1, (0.007, 0.0), 0.0, 0.00365, 4.410e-7, (-0.0115, 0.0))
    k3 = body("K3", m.ground, B, 0.455279819163070380255912382449, 0.02373, 5.255e-6, (0.01043, -0.01874))
    k5 = body("K5", m.ground, A, 0.487364979543842550225598953530, 0.07050, 1.169e-5, (0.02308, 0.00916))
    k4 = body("K4", k5, (0.04, 0.0), phi, 0.00706, 5.667e-7, (0.0, -(0.02 - 0.01421)))
    k7 = body("K7", m.ground, A, 1.23054744454982119249735015568, 0.05498, 1.912e-5, (-0.00449, -0.01228))
    k6 = body("K6", k7, (0.0, -0.04), -phi, 0.00706, 5.667e-7, (0.02 - 0.01421, 0.0))
    tip = (-0.028 * L, 0.0, 0.0)
    for name, link, at in (("P3", k3, (0.0, -0.035)), ("P4", k4, (0.0, -0.02)), ("P6", k6, (0.02, 0.0))):
        m.cut(name, RevoluteCutJoint(at_a=(at[0] * L, at[1] * L, 0.0), at_b=tip), link, k2)
    m.force("motor", JointForce(magnitude=0.033 * scale.torque), k1)
    spring = Spring(
        stiffness=4530.0 * ms / scale.times**2,
        free=0.07785 * L,
        at_a=(0.02 * L, -0.018 * L, 0.0),
        at_b=(0.014 * L, 0.072 * L, 0.0),
    )
    m.force("spring", spring, k3, m.ground)
    return Case(_finish(m), None, 0.03 * scale.times)


SLEWING = ("constant", "run-up", "harmonic")


def crane(*, drive: str = "run-up", start: float = 0.0, axis: Any = "y", scale: Scale = UNSCALED) -> Case:
    """A planar loop on a base that slews: boom, cylinder, piston on a spring. ``start`` of the base in degrees.

    ``drive``: at constant speed, run up to 36 deg/s in 1 s, or harmonically; ``axis`` of the base.
    """
    L, ms, T, at = scale.lengths, scale.masses, scale.times, radians(start)
    laws = {
        "constant": Polynomial((at, radians(36.0) / T)),
        "run-up": RunUp(speed=radians(36.0) / T, duration=T, start=at),
        "harmonic": Harmonic(amplitude=1.0, frequency=0.3 / T, mean=at),
    }
    m = _vertical(scale)
    base = m.body("base", m.ground, Revolute(axis=axis, drive=laws[drive]), mass=5 * ms, inertia=(ms * L * L,) * 3)
    boom = m.body("boom", base, Revolute(at=(0.0, L, 0.0), start=0.5, fixed=True), **rod(mass=2 * ms, length=3 * L))
    pin = np.array((1.2 * cos(0.5), 1.0 + 1.2 * sin(0.5)))  # of the piston on the boom
    foot = np.array((0.6, 0.2))
    length, lean = float(np.hypot(*(pin - foot))), float(np.arctan2(*(pin - foot)[::-1]))
    cylinder = m.body(
        "cylinder", base, Revolute(at=(0.6 * L, 0.2 * L, 0.0), start=lean), **rod(mass=0.5 * ms, length=0.6 * L)
    )
    piston = m.body(
        "piston", cylinder, Translational(axis="x", start=length * L), **rod(mass=0.3 * ms, length=-0.5 * L)
    )
    m.cut("pin", RevoluteCutJoint(at_b=(1.2 * L, 0.0, 0.0)), piston, boom)
    m.force("oil", JointSpring(stiffness=400.0 * ms / T**2, free=1.1 * length * L), piston)
    return Case(_finish(m), None, 5.0 * T)


GAPS = tuple(s * 10.0**k for k in range(-9, -1) for s in (1.0, -1.0))  # 1e-9 ... 1e-2, both signs

CASES: dict[str, Callable[..., Case]] = {  # every one with ``scale``
    "parallelogram": parallelogram,
    "parallelogram + 1e-5": lambda **k: parallelogram(1e-5, **k),
    "grashof + 1e-2": lambda **k: grashof(1e-2, **k),
    "grashof + 1e-5": lambda **k: grashof(1e-5, **k),
    "grashof - 1e-5": lambda **k: grashof(-1e-5, **k),
    "three cranks": three_cranks,
    "three cranks, singular": lambda **k: three_cranks(start=10.0, **k),
    "table": table,
    "table, singular": lambda **k: table(start=10.0, **k),
    "double parallelogram": double_parallelogram,
    "double parallelogram, singular": lambda **k: double_parallelogram(start=(15.0, -50.0), **k),
    "slider-crank": slider_crank,
    "slider-crank + 1e-5": lambda **k: slider_crank(1e-5, **k),
    "slider-crank - 1e-5": lambda **k: slider_crank(-1e-5, **k),
    "bricard": bricard,
    "ladder of 5": lambda **k: ladder(5, **k),
    "ladder of 30": lambda **k: ladder(30, **k),
    "2 four-bars": n_four_bar,
    "10 four-bars": lambda **k: n_four_bar(10, **k),
    "squeezer": squeezer,
    "crane": crane,
    "crane, harmonic": lambda **k: crane(drive="harmonic", **k),
}
