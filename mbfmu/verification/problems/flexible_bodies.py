"""Bodies with modes: the flexible slider-crank of the IVP test set, and a beam that is spun up."""

from __future__ import annotations

from itertools import pairwise
from math import cos, pi, sin

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from mbfmu.mechanics import FlexibleBody, Mechanism, Polynomial, Revolute, RunUp, TranslationalCutJoint
from mbfmu.mechanics.flexible.construction import Frame as Interface
from mbfmu.mechanics.flexible.invariants import Invariants
from mbfmu.verification.mechanisms.frames import Frame
from mbfmu.verification.problem import NUDGE, Exact, Motion, Reference, Source
from mbfmu.verification.references import integrated

from .sources import IVP_TEST_SET

Array = NDArray[np.float64]

# ---- slider-crank of the IVP test set --------------------------------------------------------------------------------

CRANK_LENGTH, ROD_LENGTH, CRANK_RATE, CRANK_END = 0.15, 0.30, 150.0, 0.1  # m, m, rad/s, s
ROD_MASS, BLOCK_MASS, ROD_INERTIA = 0.151104, 0.075552, 0.0045339259  # kg, kg, kg m^2 about the crank pin
YOUNG, SIDE, ROUNDED_PI = 0.2e12, 0.008, 3.1415927  # Pa, m, and pi as the test set has it
ROD_START = (0.0, 0.0, 0.103339863e-4, 0.169327969e-4)  # m
ROD_RATE = (0.444896105, 0.463434311e-2, -0.178591076e-5, -0.268938672e-5)  # m/s
ROD_DEFLECTION = 1e-3  # m, size of the deflections, to which errors of the solver are relative
# Amplitudes of two sines, distance of both pins, position of the slider; at 0.1 s, m
PUBLISHED_ROD = (1.893192460247178e-4, 2.375751865617931e-5, ROD_LENGTH - 8.363283141616840e-6, 1.697373326718410e-1)


class SimeonRod:
    """Integrals of the rod for its four coordinates, in the notation of the test set.

    The rod deflects by q1 sin(pi x / L) + q2 sin(2 pi x / L); displacements along it are quadratic with q3 in the
    middle and q4 at the end. The masses of q3 and q4 are 15 times those of the rod, as in the program of the test set.
    """

    def __init__(self) -> None:
        p, mass = ROUNDED_PI, ROD_MASS
        stiffness, slender = YOUNG * SIDE**2 / ROD_LENGTH, (SIDE / ROD_LENGTH) ** 2
        self.M, self.K, coupled = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4))
        self.M[:2, :2] = 0.5 * mass * np.eye(2)
        self.M[2:, 2:] = mass * np.array(((8.0, 1.0), (1.0, 2.0)))
        self.K[:2, :2] = stiffness * slender * p**4 * np.diag((1.0 / 24.0, 2.0 / 3.0))
        self.K[2:, 2:] = stiffness / 3.0 * np.array(((16.0, -8.0), (-8.0, 7.0)))
        coupled[0, 2], coupled[0, 3], coupled[1, 3] = -16.0 / p**3, 8.0 / p**3 - 1.0 / p, 0.5 / p
        self.B = mass * (coupled - coupled.T)
        self.along, self.across = mass * np.array(((0.0, 0.0, 2.0 / 3.0, 1.0 / 6.0), (2.0 / p, 0.0, 0.0, 0.0)))
        self.moment_along, self.moment_across = (
            mass * ROD_LENGTH * np.array(((0.0, 0.0, 1.0 / 3.0, 1.0 / 6.0), (1.0 / p, -0.5 / p, 0.0, 0.0)))
        )
        self.slopes = p / ROD_LENGTH * np.array((-1.0, 2.0, 0.0, 0.0))  # at the slider


def simeon_body() -> tuple[FlexibleBody, Array]:
    """Return the rod as a body whose frame is at the crank pin, x along the chord, and its modes (4, 4) as columns.

    The first two modes are the sines.
    """
    rod = SimeonRod()
    squares, V = eigh(rod.K, rod.M)
    V /= V[np.abs(V).argmax(axis=0), np.arange(4)]
    masses = np.diag(V.T @ rod.M @ V)
    S1, h1, J1 = np.zeros((3, 4)), np.zeros((3, 4)), np.zeros((6, 4))
    J2, C, none = np.zeros((6, 4, 4)), np.zeros((3, 4, 4)), np.zeros((3, 4, 4))
    S1[0], S1[1], h1[2] = rod.along @ V, rod.across @ V, rod.moment_across @ V
    J1[2], J2[2] = 2.0 * rod.moment_along @ V, 2.0 * V.T @ rod.M @ V
    C[2] = V.T @ rod.B.T @ V
    J0, com = ROD_INERTIA * np.diag((1e-3, 1.0, 1.0)), np.array((0.5 * ROD_LENGTH, 0.0, 0.0))
    ends, motion = np.array(((0.0, 0.0, 0.0), (ROD_LENGTH, 0.0, 0.0))), np.zeros((6, 4))
    motion[0], motion[5] = V[3], rod.slopes @ V
    fixed = np.zeros((6, 4, 4))
    body = FlexibleBody(
        frame="crank",
        mass=ROD_MASS,
        com=com,
        inertia=J0 - ROD_MASS * (com @ com) * np.diag((0.0, 1.0, 1.0)),
        frequencies=np.sqrt(squares),
        damping=np.zeros(4),
        nodes=ends,
        shapes=np.array((np.zeros((3, 4)), motion[:3])),
        interfaces={
            "crank": Interface(ends[0], np.zeros((6, 4)), fixed),
            "slider": Interface(ends[1], motion, fixed),
        },
        stiffening=False,
        modal_masses=masses,
        _invariants=Invariants(ROD_MASS, ROD_MASS * com, J0, S1, h1, J1, J2, C, none, none),
    )
    return body, V


def flexible_slider_crank() -> Mechanism:
    """Return the crank with constant speed, the flexible rod and the slider."""
    body, V = simeon_body()
    start, rate = (np.linalg.solve(V, values) for values in (ROD_START, ROD_RATE))
    m = Mechanism()
    crank = m.body("crank", m.ground, Revolute(drive=Polynomial((0.0, CRANK_RATE))), mass=0.36, inertia=(1e-3,) * 3)
    pin = Revolute(at=(CRANK_LENGTH, 0.0, 0.0))
    rod = m.flexible_body("rod", crank, pin, body, start=tuple(start), rate=tuple(rate))
    slider = m.body("slider", rod.section("slider"), Revolute(), mass=BLOCK_MASS, inertia=(1e-5,) * 3)
    m.cut("guide", TranslationalCutJoint(axis="x"), m.ground, slider)
    for k in range(2):
        m.output(f"q{k + 1}", rod.modes.coordinate(k), "Amplitude of a sine")
    m.output("length", m.relative_position(rod.section("slider"), rod.body, "x"), "Distance of both pins")
    m.output("x", slider.position("x"), "Position of the slider")
    return m


def slider_crank_right(rod: SimeonRod, t: float, y: Array) -> Array:
    """Return the rates of the coordinates (4,) of the rod and of their velocities.

    Lagrange's equations; the angle of the rod and its rate follow from the crank and the length L + q4.
    """
    q, dq = y[:4], y[4:]
    s, c, length = sin(CRANK_RATE * t), cos(CRANK_RATE * t), ROD_LENGTH + q[3]
    sine = -CRANK_LENGTH * s / length
    cosine = np.sqrt(1.0 - sine * sine)
    w = -(CRANK_LENGTH * c * CRANK_RATE + sine * dq[3]) / (length * cosine)
    turn_s, turn_c = s * cosine - c * sine, c * cosine + s * sine  # of the crank relative to the rod
    # w' = turn_0 + turn_1 q4'', x'' = push_0 + push_1 q4''
    turn_0 = (CRANK_LENGTH * s * CRANK_RATE**2 + length * sine * w * w - 2.0 * w * cosine * dq[3]) / (length * cosine)
    turn_1 = -sine / (length * cosine)
    push_0 = -CRANK_LENGTH * c * CRANK_RATE**2 - length * (cosine * w * w + sine * turn_0) - 2.0 * w * sine * dq[3]
    push_1 = cosine - length * sine * turn_1
    Mq = rod.M @ q
    inertia = ROD_INERTIA + q @ Mq + 2.0 * rod.moment_along @ q
    coupling = rod.moment_across + q @ rod.B
    pull = CRANK_LENGTH * CRANK_RATE**2
    moment = pull * (turn_s * (0.5 * ROD_LENGTH * ROD_MASS + rod.along @ q) - turn_c * (rod.across @ q))
    moment -= 2.0 * w * (rod.moment_along @ dq + Mq @ dq)
    force = w * w * (Mq + rod.moment_along) + pull * (turn_c * rod.along + turn_s * rod.across)
    force += 2.0 * w * (rod.B @ dq) - rod.K @ q
    M = rod.M.copy()
    M[:, 3] += coupling * turn_1
    f = force - coupling * turn_0
    M[3] += turn_1 * coupling
    M[3, 3] += turn_1 * turn_1 * inertia + push_1 * push_1 * BLOCK_MASS
    f[3] += turn_1 * (moment - inertia * turn_0) - push_1 * push_0 * BLOCK_MASS
    return np.concatenate((dq, np.linalg.solve(M, f)))


class SliderCrankMotion:
    """Motion by SciPy, with the published values at the end."""

    uncertainty = 1e-10  # m: published values and SciPy differ by 4e-11 m

    def at(self, times: Array) -> Reference:
        """Return the reference at times (k,), s; the last time is that of the published values."""
        values = self.motion(times, 0.0, 1e-11)
        change = np.abs(self.motion(times, NUDGE, 1e-9) - self.motion(times, 0.0, 1e-9)) / NUDGE
        values[-1] = PUBLISHED_ROD
        return Reference(values, np.maximum.accumulate(change), self.uncertainty)

    def motion(self, times: Array, nudge: float, tolerance: float) -> Array:
        """Return the quantities (k, 4), with random changes of the state at each of the times."""
        rod, y, rng = SimeonRod(), np.array(ROD_START + ROD_RATE), np.random.default_rng(len(times))
        scales, states = ROD_DEFLECTION * np.repeat((1.0, CRANK_RATE), 4), [y]
        for begin, end in pairwise(times):
            y = y + nudge * scales * rng.choice((-1.0, 1.0), 8)
            found = solve_ivp(
                lambda t, y: slider_crank_right(rod, t, y),
                (begin, end),
                y,
                method="DOP853",
                rtol=tolerance,
                atol=tolerance * scales,
                first_step=1e-6,
            )
            y = found.y[:, -1]
            states.append(y)
        q = np.array(states)[:, :4]
        length = ROD_LENGTH + q[:, 3]
        x = CRANK_LENGTH * np.cos(CRANK_RATE * times) + np.sqrt(
            length**2 - (CRANK_LENGTH * np.sin(CRANK_RATE * times)) ** 2
        )
        return np.column_stack((q[:, :2], length, x))


# ---- spin-up of a beam -----------------------------------------------------------------------------------------------

BEAM, BENDING, AXIAL, RHO = 10.0, 1.4e4, 2.8e7, 1.2  # m, N m^2, N, kg/m
FINAL_SPEED, SPIN_UP, SPIN_END = 6.0, 15.0, 20.0  # rad/s, s, s
SPUN_ELEMENTS, SPUN_SHAPES = 12, 4  # four shapes have an error of 2e-6 m, eight one of 1e-10 m


def spun_beam(elements: int = SPUN_ELEMENTS, modes: int = 4) -> Mechanism:
    """Return the beam of finite elements, with geometric stiffening, on a hub with a given motion."""
    nodes = np.column_stack((np.linspace(0.0, BEAM, elements + 1), np.zeros((elements + 1, 2))))
    beam = Frame(
        nodes,
        pairwise(range(elements + 1)),
        axial=AXIAL,
        bending=(BENDING, BENDING),
        torsion=BENDING,
        rho=RHO,
        spin=RHO * 5e-4,
    )
    interfaces = {"hub": [0], "tip": [elements]}
    body = FlexibleBody.from_fe(
        beam.M, beam.K, nodes, interfaces, modes=modes, geometric_stiffness=beam.geometric_stiffness
    )
    m = Mechanism()
    hub = Revolute(drive=RunUp(speed=FINAL_SPEED, duration=SPIN_UP))
    handle = m.flexible_body("beam", m.ground, hub, body)
    for axis in "xy":
        m.output(axis, m.relative_position(handle.section("tip"), handle.body, axis), f"Coordinate {axis} of the tip")
    return m


def hub_motion(t: float) -> tuple[float, float]:
    """Return speed, rad/s, and acceleration of the hub; Kane, Ryan and Banerjee (1987)."""
    if t >= SPIN_UP:
        return FINAL_SPEED, 0.0
    phase = 2.0 * pi * t / SPIN_UP
    return FINAL_SPEED / SPIN_UP * (t - sin(phase) * SPIN_UP / (2.0 * pi)), FINAL_SPEED / SPIN_UP * (1.0 - cos(phase))


class Elastica:
    """Inextensible beam with large rotations in a frame that rotates, by the method of Ritz.

    The angle relative to the hub is sum_j q_j f_j(s), with integrals f_j of Legendre polynomials, so that it is zero at
    the hub. With the unit vectors t and n = t' of the tangent, the acceleration of a point is the integral of
    theta'' n - theta'^2 t along the beam; the strain energy is the integral of E I (d theta / ds)^2 / 2.
    """

    def __init__(self, shapes: int = SPUN_SHAPES, points: int = 24) -> None:
        nodes, weights = np.polynomial.legendre.leggauss(points)
        self.weights = 0.5 * BEAM * weights
        P = np.polynomial.Legendre
        basis = [P.basis(j) for j in range(shapes)]
        self.f = np.array([0.5 * BEAM * b.integ(lbnd=-1.0)(nodes) for b in basis]).T  # (points, shapes)
        df = np.array([b(nodes) for b in basis]).T
        self.K = BENDING * (df.T * self.weights) @ df
        full = [P.basis(j) for j in range(points)]
        values = np.linalg.inv(np.array([b(nodes) for b in full]).T)
        self.integral = np.array([0.5 * BEAM * b.integ(lbnd=-1.0)(nodes) for b in full]).T @ values  # from the hub

    def right(self, t: float, y: Array) -> Array:
        """Return the rates of q and of its velocity, from the principle of virtual power."""
        q, dq = np.split(y, 2)
        speed, acceleration = hub_motion(t)
        theta, rate = self.f @ q, speed + self.f @ dq
        c, s = np.cos(theta), np.sin(theta)
        along = self.integral @ np.column_stack((-s[:, None] * self.f, c[:, None] * self.f))  # d r / d q, x and y
        n = len(q)
        load = self.integral @ np.column_stack((-s * acceleration - c * rate**2, c * acceleration - s * rate**2))
        weighted = RHO * self.weights[:, None] * along
        M = weighted[:, :n].T @ along[:, :n] + weighted[:, n:].T @ along[:, n:]
        f = -weighted[:, :n].T @ load[:, 0] - weighted[:, n:].T @ load[:, 1] - self.K @ q
        return np.concatenate((dq, np.linalg.solve(M, f)))

    def deflection(self, _: Array, y: Array) -> tuple[Array]:
        """Return the deflection (k,) of the tip in the frame of the hub, m, for states (2 n, k)."""
        return (self.weights @ np.sin(self.f @ y[: len(y) // 2]),)


def spun_beam_exact() -> Exact:
    """Return the motion of the tip."""
    beam = Elastica()
    scales = 0.01 * np.repeat((1.0, FINAL_SPEED), SPUN_SHAPES)
    return integrated(beam.right, np.zeros(2 * SPUN_SHAPES), scales, beam.deflection, SPIN_END)


FLEXIBLE_PROBLEMS = (
    Motion(
        name="flexible slider-crank",
        description="Slider-crank with a crank of 0.15 m at 150 rad/s and a flexible rod of steel of 0.3 m with a "
        "section of 8 x 8 mm, two modes across and two along the rod, 0.1 s.",
        sources=(
            Source(
                "B. Simeon",
                1996,
                "Modelling a flexible slider crank mechanism by a mixed system of DAEs and PDEs. Mathematical "
                "Modelling of Systems 2, 1-18",
                "https://doi.org/10.1080/13873959608837026",
            ),
            IVP_TEST_SET,
        ),
        quantity="Amplitudes of two modes, distance of both pins, position of the slider",
        unit="m",
        derivation="SciPy DOP853 on Lagrange's equations; published values at the end",
        build=flexible_slider_crank,
        outputs=("q1", "q2", "length", "x"),
        exact=SliderCrankMotion,
        stop_time=CRANK_END,
        is_quick=False,
    ),
    Motion(
        name="spin-up of a beam",
        description=f"Beam of 10 m, {SPUN_ELEMENTS} finite elements reduced to four modes and the motions of its tip, "
        "with geometric stiffening; its root is turned up to 6 rad/s in 15 s; 20 s.",
        sources=(
            Source(
                "T. R. Kane, R. R. Ryan, A. K. Banerjee",
                1987,
                "Dynamics of a cantilever beam attached to a moving base. Journal of Guidance, Control, and Dynamics "
                "10, 139-151",
                "https://doi.org/10.2514/3.20195",
            ),
            Source(
                "J. C. Simo, L. Vu-Quoc",
                1986,
                "On the dynamics of flexible beams under large overall motions - The plane case: Part II. Journal of "
                "Applied Mechanics 53, 855-863",
                "https://doi.org/10.1115/1.3171871",
            ),
        ),
        quantity="Deflection of the tip",
        unit="m",
        derivation="method of Ritz for the inextensible elastica with large rotations, SciPy DOP853",
        build=spun_beam,
        outputs=("y",),
        exact=spun_beam_exact,
        stop_time=SPIN_END,
        solvers=("radau", "ida"),
        model_error=2e-3,
        is_quick=False,
    ),
)
