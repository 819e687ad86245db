"""Mechanics by identities on random mechanisms: what must hold whatever the numbers are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from random_mechanisms import COUPLINGS, CUTS, JOINTS, MOVING, Case, build, cases, distance

from mbfmu.mechanics import CompiledMechanism, Mechanism, Screw
from mbfmu.mechanics.recursions.aba import forward_dynamics
from mbfmu.mechanics.recursions.dynamics import inverse_dynamics_at_solution, update_kinematics
from mbfmu.mechanics.recursions.kinematics import update_positions as place_joints
from mbfmu.mechanics.recursions.rnea import momentum
from mbfmu.sheets import Geodesic, Stretching
from mbfmu.testing.identities import State, difference_quotient, path

TOLERANCE = 1e-9


def close(a: Any, b: Any, scale: float = 1.0) -> None:
    """Agree to the tolerance, relative to the larger of 1, the values and ``scale``."""
    size = max(1.0, scale, float(np.abs(a).max(initial=0.0)), float(np.abs(b).max(initial=0.0)))
    np.testing.assert_allclose(a, b, rtol=0, atol=TOLERANCE * size)


def along(case: Case, s: float) -> tuple[float, Any, Any]:
    """State at time s from the case's on the path with constant v' = a."""
    return path(case.compiled, State(case.t, case.q, case.v, case.a, np.zeros(0)), s)


def derivative(case: Case, function: Any) -> Any:
    """Time derivative of ``function(t, q, v)`` along that path."""
    return difference_quotient(lambda s: function(*along(case, s)))


def observed(case: Case, t: float, q: Any, v: Any, a: Any, lam: Any) -> dict[str, float]:
    """All outputs by name."""
    out = np.zeros(len(case.compiled.outputs))
    case.compiled.observe(t, q, v, a, lam, out)
    return {variable.name: float(x) for variable, x in zip(case.compiled.outputs, out, strict=True)}


@pytest.mark.parametrize("joint", JOINTS)
def test_a_joint_has_as_many_motions_as_declared_and_places_by_a_rotation(joint: Any) -> None:
    m = Mechanism()
    needed: dict[Any, dict[str, Any]] = {kind: {"at": (1.0, 0.0, 0.0)} for kind in (Geodesic, Stretching)}
    needed[Screw] = {"lead": 0.1}
    m.body("b", m.ground, joint(**needed.get(joint, {})), mass=1.0)
    compiled = CompiledMechanism(m)
    arrays, state = compiled.kernel_data
    compiled.data.state.q[:] = np.array([0.6, 0.0, 0.8, 0.0, 0.0, 0.0, 1.0])[: joint.nq]
    rel = compiled.data.state.rel
    rel["S"] = 0.0
    place_joints(arrays, state)
    assert int(np.sum(np.abs(rel["S"][0]).max(axis=1) > 0)) == joint.nv
    np.testing.assert_allclose(rel["R"][0] @ rel["R"][0].T, np.eye(3), atol=1e-15)


@settings(deadline=None)
@given(cases(forces=True))
def test_mass_matrix_is_inverse_dynamics_by_columns(case: Case) -> None:
    system, data = case.compiled.system, case.compiled.data
    terms = system.allocate_terms()
    system.fill(case.t, case.q, case.v, terms)
    inverse_dynamics_at_solution(case.t, case.q, case.v, case.a, np.zeros(0), case.compiled.kernel_data)
    free = data.arrays.bodies["vf"][1:]
    tau = np.concatenate(
        [data.state.tau[b["vi"] : b["vi"] + b["nv"]] for b in data.arrays.bodies[1:]] if len(free) else []
    )
    close(tau, terms.M @ case.a + terms.h)


@settings(deadline=None)
@given(cases())
def test_kinetic_energy_is_the_mass_matrix_form(case: Case) -> None:
    system = case.compiled.system
    terms = system.allocate_terms()
    system.fill(case.t, case.q, case.v, terms)
    at_rest = case.compiled.energy(case.t, case.q, 0 * case.v)
    kinetic = case.compiled.energy(case.t, case.q, case.v) - at_rest
    close(kinetic, 0.5 * case.v @ terms.M @ case.v, abs(at_rest))


@settings(deadline=None)
@given(cases(forces=True))
def test_inverse_dynamics_undoes_articulated_body(case: Case) -> None:
    data = case.compiled.data
    update_kinematics(case.t, case.q, case.v, *case.compiled.kernel_data)
    assert forward_dynamics(*case.compiled.kernel_data) == 0
    terms = case.compiled.system.allocate_terms()
    a = data.state.a.copy()
    case.compiled.system.fill(case.t, case.q, case.v, terms)
    close(terms.M @ a + terms.h, np.zeros_like(a), float(np.abs(terms.h).max()))


@settings(deadline=None)
@given(cases(driven=True, forces=True))
def test_articulated_body_with_a_drive_agrees_with_the_free_equations(case: Case) -> None:
    data, system = case.compiled.data, case.compiled.system
    update_kinematics(case.t, case.q, case.v, *case.compiled.kernel_data)
    assert forward_dynamics(*case.compiled.kernel_data) == 0
    free = np.concatenate([np.arange(b["vi"], b["vi"] + b["nv"]) for b in data.arrays.bodies[1:] if b["vf"] >= 0])
    a = data.state.a[free.astype(int)].copy()
    terms = system.allocate_terms()
    system.fill(case.t, case.q, case.v, terms)
    close(terms.M @ a + terms.h, np.zeros_like(a), float(np.abs(terms.h).max()))


@settings(deadline=None)
@given(cases(cuts=True, driven=True))
def test_constraint_derivatives(case: Case) -> None:
    system = case.compiled.system
    terms = system.allocate_terms()

    def Phi(t: float, q: Any, v: Any) -> Any:
        system.fill(t, q, v, terms)
        return terms.Phi.copy()

    def Phi_rate(t: float, q: Any, v: Any) -> Any:
        system.fill(t, q, v, terms)
        return terms.J @ v - terms.nu

    first, second = derivative(case, Phi), derivative(case, Phi_rate)
    system.fill(case.t, case.q, case.v, terms)
    close(first, np.where(restricts_velocities(system), 0.0, terms.J @ case.v - terms.nu))
    close(second, terms.J @ case.a - terms.gamma)


def restricts_velocities(system: Any) -> Any:
    """Which constraint equations are nonholonomic."""
    return np.isin(np.arange(system.m), system.nonholonomic)


@settings(deadline=None)
@given(cases(driven=True))
def test_point_velocity_and_acceleration(case: Case) -> None:
    lam = np.zeros(case.compiled.system.m)
    exact = observed(case, case.t, case.q, case.v, case.a, lam)

    def outputs(t: float, q: Any, v: Any) -> Any:
        return np.array(list(observed(case, t, q, v, case.a, lam).values()))

    rates = dict(zip(exact, derivative(case, outputs), strict=True))
    for body in case.compiled.mechanism.bodies[1:]:
        for axis in "xyz":
            close(rates[f"{body.name}.r{axis}"], exact[f"{body.name}.v{axis}"])
            close(rates[f"{body.name}.v{axis}"], exact[f"{body.name}.a{axis}"])


@settings(deadline=None)
@given(cases(cuts=True, driven=True, forces=True))
def test_power_equals_energy_rate(case: Case) -> None:
    """dE/dt is the power of free coordinates' net effort, drives, cut joints, dampers and given forces."""
    compiled, system = case.compiled, case.compiled.system
    rng = np.random.default_rng(1)
    lam = rng.normal(size=system.m)
    terms = system.allocate_terms()
    rate = derivative(case, compiled.energy)
    system.fill(case.t, case.q, case.v, terms)
    effort = terms.M @ case.a + terms.h + terms.J.T @ lam  # what would have to act on the free coordinates
    out = observed(case, case.t, case.q, case.v, case.a, lam)
    drive = out["b0.effort"] * out["b0.drive_rate"]
    cut = -lam @ (terms.J @ case.v - terms.nu)
    power = effort @ case.v + drive + cut + non_conservative_power(case)
    close(rate, power, float(np.abs(effort).max(initial=0.0)))


def non_conservative_power(case: Case) -> float:
    """Power of dampers and given forces, from the records and the body motions, written out again."""
    compiled, power = case.compiled, 0.0
    state, signals = compiled.data.state, compiled.signals(compiled.data)
    for _, force, a, b in compiled.mechanism.forces:
        name, f = type(force).__name__, compiled.records(type(force))[0]
        A, B = state.bodies[a.index], state.bodies[b.index]

        def velocity(body: Any, p: Any) -> Any:
            return body["Y"][:3] + np.cross(body["Y"][3:], body["A"] @ p)

        magnitude = (
            np.polyval(signals[int(f["signal"])].record["c"][::-1], case.t) if hasattr(force, "magnitude") else 0.0
        )
        if name in ("Spring", "Damper"):
            d = B["r"] + B["A"] @ f["Pb"] - A["r"] - A["A"] @ f["Pa"]
            rate = d @ (velocity(B, f["Pb"]) - velocity(A, f["Pa"])) / np.linalg.norm(d)
            power -= f["damping"] * rate**2
        elif name in ("JointSpring", "JointDamper"):
            power -= f["damping"] * state.v[int(f["v"])] ** 2
        elif name == "JointForce":
            power += magnitude * state.v[int(f["v"])]
        elif name == "PointForce":
            power += magnitude * fixed(force, f, A) @ velocity(A, f["Pa"])
        elif name == "LineForce":
            power += magnitude * distance(f, A, B)[1]
        elif name == "JointStop":
            q, rate = state.q[int(f["q"])], state.v[int(f["v"])]
            power -= f["stiffness"] * f["damping"] * max(f["lower"] - q, q - f["upper"], 0.0) * rate**2
        elif name == "DistanceStop":
            length, rate = distance(f, A, B)
            power -= f["stiffness"] * f["damping"] * max(f["lower"] - length, length - f["upper"], 0.0) * rate**2
        elif name == "TorsionSpring":
            power -= f["damping"] * twist_rate(f["Ea"], f["Eb"], A, B) ** 2
        elif name == "Bushing":
            power -= f["damping"] @ bushing_rate(f, A, B) ** 2
        elif name == "BeamElement":
            rate = beam_rate(A, B)
            power -= f["damping"] * rate @ cantilever(f["stiffness"], f["length"]) @ rate
        else:
            assert name == "Torque"
            power += magnitude * fixed(force, f, A) @ A["Y"][3:]
    return power


def fixed(force: Any, f: Any, A: Any) -> Any:
    """Global axis of a given force or torque."""
    return A["A"] @ f["axis"] if force.fixed_in == "body" else f["axis"]


def twist_rate(Ea: Any, Eb: Any, A: Any, B: Any) -> float:
    """Rate of the angle of the upper left corner of R, the attitude of a frame in b in one in a."""
    R = Ea @ A["A"].T @ B["A"] @ Eb.T
    dR = np.cross(Ea @ A["A"].T @ (B["Y"][3:] - A["Y"][3:]), R, axis=0)
    s, c, ds, dc = R[1, 0] - R[0, 1], R[0, 0] + R[1, 1], dR[1, 0] - dR[0, 1], dR[0, 0] + dR[1, 1]
    return float((c * ds - s * dc) / (s * s + c * c))


def bushing_rate(f: Any, A: Any, B: Any) -> Any:
    """Rates of displacement and turn 2 v of b's frame in a's; v from its axial vector 4 w v."""
    E, at_b = A["A"] @ f["Ea"].T, B["A"] @ f["Pb"]
    R, w = E.T @ B["A"] @ f["Eb"].T, A["Y"][3:]
    dR = np.cross(E.T @ (B["Y"][3:] - w), R, axis=0)
    rise = B["Y"][:3] + np.cross(B["Y"][3:], at_b) - A["Y"][:3] - np.cross(w, B["r"] + at_b - A["r"])
    four = 2.0 * np.sqrt(1.0 + np.trace(R))  # 4 w

    def axial(M: Any) -> Any:
        return np.array([M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]])

    return np.concatenate((E.T @ rise, 2.0 * (axial(dR) - axial(R) * np.trace(dR) / (2.0 + 2.0 * np.trace(R))) / four))


def beam_rate(A: Any, B: Any) -> Any:
    """Rates of displacement and turn of body b in the axes of body a."""
    R = A["A"].T @ B["A"]
    spin = A["A"].T @ (B["Y"][3:] - A["Y"][3:])
    dR = np.cross(spin, R, axis=0)
    rise = B["Y"][:3] - A["Y"][:3] - np.cross(A["Y"][3:], B["r"] - A["r"])
    turn = [0.5 * (dR[2, 1] - dR[1, 2]), 0.5 * (dR[0, 2] - dR[2, 0]), 0.5 * (dR[1, 0] - dR[0, 1])]
    return np.concatenate((A["A"].T @ rise, turn))


def cantilever(section: Any, h: float) -> Any:
    """Stiffness of a cantilever at its tip: the inverse of h / EA, h / GJ, h^3 / 3 EI, h^2 / 2 EI, h / EI."""
    axial, torsion, bend_y, bend_z = section
    K = np.diag([axial / h, 0.0, 0.0, torsion / h, 0.0, 0.0])
    for flexibility, (w, turn), sign in ((bend_y, (1, 5), 1.0), (bend_z, (2, 4), -1.0)):
        tip = np.array([[h**3 / 3.0, sign * h**2 / 2.0], [sign * h**2 / 2.0, h]]) / flexibility
        K[np.ix_((w, turn), (w, turn))] = np.linalg.inv(tip)
    return K


@settings(deadline=None)
@given(cases())
def test_momentum_changes_with_what_the_ground_gives(case: Case) -> None:
    compiled, zero = case.compiled, np.zeros(0)

    def total(t: float, q: Any, v: Any) -> Any:
        out = np.zeros(6)
        inverse_dynamics_at_solution(t, q, v, case.a, zero, compiled.kernel_data)
        momentum(*compiled.kernel_data, out)
        return out

    rate = derivative(case, total)
    inverse_dynamics_at_solution(case.t, case.q, case.v, case.a, zero, compiled.kernel_data)
    g, expected = compiled.mechanism.gravity, np.zeros(6)
    for record, here in zip(compiled.data.arrays.bodies[1:], compiled.data.state.bodies[1:], strict=True):
        weight = record["mass"] * g
        expected[:3] += weight
        expected[3:] += np.cross(here["r"] + here["com"], weight)
        if record["parent"] == 0:
            expected[:3] += here["W"][:3]
            expected[3:] += here["W"][3:] + np.cross(here["r"], here["W"][:3])
    close(rate, expected)


@pytest.mark.parametrize("kind", MOVING)
def test_every_joint_moves_in_a_loop(kind: Any) -> None:
    """The strategies draw at random; this makes sure that each joint and each cut joint was there."""
    for cut in CUTS:
        case = build(7, [kind, Geodesic], [cut], False, True)
        terms = case.compiled.system.allocate_terms()
        case.compiled.system.fill(case.t, case.q, case.v, terms)
        assert np.all(np.isfinite(terms.J))
        assert np.abs(terms.J).max() > 0.0


@pytest.mark.parametrize("kind", [joint for joint in MOVING if joint.nv > 3 * joint.quaternion])
def test_every_joint_is_coupled(kind: Any) -> None:
    """Phi, J, gamma and the power of every coupling, one end driven or not; the strategies draw at random."""
    for seed, driven in ((1, False), (2, kind.nv == 1)):
        case = build(seed, [kind, kind], COUPLINGS, driven, False)
        system, terms = case.compiled.system, case.compiled.system.allocate_terms()
        assert system.m == len(COUPLINGS)

        def rates(t: float, q: Any, v: Any, system: Any = system, terms: Any = terms) -> Any:
            system.fill(t, q, v, terms)
            return np.concatenate((terms.Phi, terms.J @ v - terms.nu))

        found = derivative(case, rates)
        system.fill(case.t, case.q, case.v, terms)
        close(found, np.concatenate((terms.J @ case.v - terms.nu, terms.J @ case.a - terms.gamma)))
