"""Rotors of geared drives: identities, closed forms, and SciPy.

The identities of ``random_mechanisms`` contain armatures in all recursions.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu
from random_mechanisms import JOINTS, build
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.fmi.export import export
from mbfmu.mechanics import CompiledMechanism, Mechanism, Revolute, RevoluteCutJoint, Spherical, Translational
from mbfmu.util.errors import UserError

SIZES = (1e-3, 1.0, 1e3)  # m
TIGHT: dict[str, Any] = {"solver": "adams", "tolerance": 1e-10}
needs_compiler = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("driven", [False, True])
def test_only_the_diagonal_of_the_mass_matrix_changes(seed: int, driven: bool) -> None:
    random = np.random.default_rng(seed)
    kinds = [Revolute, *(JOINTS[k] for k in random.integers(0, len(JOINTS), 4)), Translational, Revolute]
    case = build(seed, kinds, [], driven, True)
    system, bodies = case.compiled.system, case.compiled.data.arrays.bodies
    armature = np.zeros(system.n)
    own = bodies[(bodies["vf"] >= 0) & (bodies["nv"] == 1)]
    armature[own["vf"]] = own["armature"]
    assert np.count_nonzero(armature) >= 2
    found = []
    for _ in range(2):
        terms = system.allocate_terms()
        system.fill(case.t, case.q, case.v, terms)
        found.append(terms)
        bodies["armature"] = 0.0
    size = np.abs(found[0].M).max()
    np.testing.assert_allclose(found[0].M - found[1].M, np.diag(armature), rtol=1e-12, atol=1e-14 * size)
    np.testing.assert_array_equal(found[0].h, found[1].h)


@dataclass(frozen=True, kw_only=True)
class GearedDisc(mb.Model):
    """A motor turns a disc by a gear, or draws a slider of the same inertia per size squared."""

    ratio: float = mb.parameter(20.0, min=1.0, doc="Gear ratio")
    rotor: float = mb.parameter(3e-3, unit="kg.m2", min=0.0, doc="Moment of inertia of the rotor")
    size: float = mb.parameter(1.0, unit="m", min=0.0, doc="Radius of gyration of the disc")
    slides: bool = mb.parameter(False, structural=True, doc="Whether the load is a slider")

    def build(self) -> Mechanism:
        m, square = Mechanism(), self.size**2
        reflected, torque = self.ratio**2 * self.rotor, mb.Input(name="torque", unit="N.m", start=0.7)
        if self.slides:
            disc = m.body("disc", m.ground, Translational(axis="z", armature=reflected), mass=2.0)
        else:
            inertia = (square, square, 2.0 * square)
            disc = m.body("disc", m.ground, Revolute(armature=reflected * square), mass=1.0, inertia=inertia)
        m.force("motor", mb.JointForce(magnitude=mb.Product(torque, self.ratio * (1 if self.slides else square))), disc)
        m.output("q", disc.coordinate())
        m.output("acceleration", disc.acceleration())
        m.output("load", disc.joint_force("z") if self.slides else disc.joint_moment("z"))
        m.output("energy", m.kinetic_energy)
        return m

    def acceleration(self) -> float:
        """Of the disc, rad/s^2: the rotor turns ``ratio`` times as fast."""
        return float(self.ratio * 0.7 / (2.0 + self.ratio**2 * self.rotor))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("slides", [False, True])
def test_a_geared_motor_accelerates_its_load_and_its_rotor(size: float, slides: bool) -> None:
    model = GearedDisc(size=size, slides=slides)
    result = mb.simulate(model, 0.5, **TIGHT)
    assert not result.warning
    a, t, unit = model.acceleration(), result.t, 1.0 if slides else size**2
    np.testing.assert_allclose(result["q"], 0.5 * a * t**2, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(result["acceleration"], a, rtol=1e-9)
    np.testing.assert_allclose(result["load"], 2.0 * a * unit, rtol=1e-9)  # what the rotor leaves of the torque
    work = model.ratio * 0.7 * result["q"] * unit
    np.testing.assert_allclose(result["energy"], work, rtol=1e-8, atol=1e-12 * work.max())


def test_the_effort_of_a_drive_accelerates_its_rotor_too() -> None:
    m, rate = Mechanism(), 2.0 * np.pi * 0.7
    motion = mb.Harmonic(amplitude=0.4, frequency=0.7)
    disc = m.body("disc", m.ground, Revolute(drive=motion, armature=3.0), mass=1.0, inertia=(1.0, 1.0, 2.0))
    m.body("tip", disc, Revolute(at=(0.0, 0.0, 0.5)), mass=1.0, inertia=(0.0, 0.0, 0.0), com=(1.0, 0.0, 0.0))
    m.output("effort", disc.effort())
    m.output("energy", m.kinetic_energy)
    m.output("jacobi", m.jacobi_integral)
    result = mb.simulate(m, 0.5, **TIGHT)
    assert not result.warning
    a, v = -0.4 * rate**2 * np.sin(rate * result.t), 0.4 * rate * np.cos(rate * result.t)
    start = 0.4 * rate  # of the tip, which turns about the same axis and has no load, without limit
    np.testing.assert_allclose(result["effort"], 5.0 * a, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(result["energy"], 2.5 * v**2 + 0.5 * start**2, rtol=1e-7)
    np.testing.assert_allclose(result["energy"] - result["jacobi"], (5.0 * v + start) * v, rtol=1e-7)


def test_an_arm_with_rotors_moves_as_scipy_integrates_it() -> None:
    """Two links in the vertical plane: the matrices of the textbook plus the armatures."""
    g, (m1, m2), (l1, l2), (r1, r2) = 9.81, (1.5, 0.8), (0.7, 0.5), (0.3, 0.05)
    m = Mechanism(gravity=(0.0, -g, 0.0))
    upper = m.body("upper", m.ground, Revolute(start=0.3, armature=r1), **mb.rod(mass=m1, length=l1))
    lower = m.body("lower", upper, Revolute(at=(l1, 0, 0), start=0.9, armature=r2), **mb.rod(mass=m2, length=l2))
    m.output("upper", upper.angle())
    m.output("lower", lower.angle())
    m.output("energy", m.energy)
    result = mb.simulate(m, 2.0, **TIGHT)
    assert not result.warning

    def law(_: float, y: Any) -> Any:
        q1, q2, v1, v2 = y
        c, s = m2 * l1 * l2 / 2.0 * np.cos(q2), m2 * l1 * l2 / 2.0 * np.sin(q2)
        inner, outer = m1 * l1**2 / 3.0 + m2 * l1**2, m2 * l2**2 / 3.0
        M = np.array(((inner + outer + 2.0 * c + r1, outer + c), (outer + c, outer + r2)))
        w2 = m2 * g * l2 / 2.0 * np.cos(q1 + q2)
        w1 = (m1 / 2.0 + m2) * g * l1 * np.cos(q1) + w2
        return np.r_[v1, v2, np.linalg.solve(M, (s * (2.0 * v1 * v2 + v2**2) - w1, -s * v1**2 - w2))]

    exact = solve_ivp(law, (0.0, 2.0), [0.3, 0.9, 0.0, 0.0], "DOP853", result.t, rtol=1e-12, atol=1e-12).y
    np.testing.assert_allclose(result["upper"], exact[0], atol=1e-7)
    np.testing.assert_allclose(result["lower"], exact[1], atol=1e-7)
    np.testing.assert_allclose(result["energy"], result["energy"][0], atol=1e-7)


def pendulums(count: int) -> tuple[Mechanism, Any]:
    """Discs on springs, and their frequencies, rad/s: sqrt(k / (I + armature))."""
    m, armature = Mechanism(), np.linspace(0.0, 6.0, count)
    for k, own in enumerate(armature):
        disc = m.body(f"disc{k}", m.ground, Revolute(start=0.1, armature=own), mass=1.0, inertia=(1.0, 1.0, 2.0))
        m.force(f"spring{k}", mb.JointSpring(stiffness=3.0), disc)
        m.output(f"angle{k}", disc.angle())
    return m, np.sqrt(3.0 / (2.0 + armature))


@pytest.mark.parametrize("count", [2, 61])
def test_rotors_lower_natural_frequencies(count: int) -> None:
    """By matrices, and by the structured tangent of large models."""
    m, rates = pendulums(count)
    found = np.sort([shape.mode.frequency for shape in mb.modes(m)])
    np.testing.assert_allclose(found, np.sort(rates)[: len(found)], rtol=1e-8)


@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_large_models_oscillate_with_their_rotors(solver: str) -> None:
    m, rates = pendulums(61)
    result = mb.simulate(m, 1.0, solver=solver, tolerance=1e-8)
    assert not result.warning
    for k, rate in enumerate(rates):
        np.testing.assert_allclose(result[f"angle{k}"], 0.1 * np.cos(rate * result.t), atol=1e-6)


def test_rotors_do_not_move_a_steady_state() -> None:
    for armature in (0.0, 4.0):
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        bob = m.body("bob", m.ground, Revolute(start=-1.2, armature=armature), **mb.rod(mass=2.0, length=1.0))
        m.force("spring", mb.JointSpring(stiffness=20.0, free=-np.pi / 2), bob)
        rest = mb.equilibrium(m)
        np.testing.assert_allclose(np.asarray(rest.q)[0], -np.pi / 2, rtol=1e-9)
        swing = np.sqrt((20.0 + 9.81) / (2.0 / 3.0 + armature))
        np.testing.assert_allclose(np.abs(np.linalg.eigvals(mb.linearize(m).A)), swing, rtol=1e-7)


def test_a_rotor_in_a_loop() -> None:
    """A parallelogram: coupler and rocker move with the crank, so that all inertias are of one angle."""
    m = Mechanism()
    crank = m.body("crank", m.ground, Revolute(start=0.4, armature=0.5, rate=1.0), **mb.rod(mass=1.0, length=1.0))
    coupler = m.body(
        "coupler", crank, Revolute(at=(1, 0, 0), start=-0.4, armature=0.25), **mb.rod(mass=3.0, length=2.0)
    )
    rocker = m.body(
        "rocker", m.ground, Revolute(at=(2, 0, 0), start=0.4, armature=0.125), **mb.rod(mass=1.0, length=1.0)
    )
    m.cut("pin", RevoluteCutJoint(at_a=(2, 0, 0), at_b=(1, 0, 0)), coupler, rocker)
    m.force("motor", mb.JointForce(magnitude=2.0), crank)
    m.output("angle", crank.angle())
    m.output("reaction", coupler.joint_moment("z"))
    result = mb.simulate(m, 0.5, **TIGHT)
    assert not result.warning
    a = 2.0 / (1.0 / 3.0 + 3.0 + 1.0 / 3.0 + 0.5 + 0.25 + 0.125)
    np.testing.assert_allclose(result["angle"], 0.4 + result.t + 0.5 * a * result.t**2, rtol=1e-9)
    np.testing.assert_allclose(result["reaction"], 0.25 * a, rtol=1e-7)  # the rotor turns back against the crank


def test_a_joint_with_a_rotor_is_in_the_tree() -> None:
    for own in range(4):
        m = Mechanism()
        bodies = [m.body(name, **mb.rod(mass=1.0, length=1.0)) for name in ("crank", "coupler", "rocker")]
        ends = [m.ground, *bodies, m.ground]
        for k in range(4):
            at = (0.0, 0.0, 0.0) if k == 0 else (1.0, 0.0, 0.0)
            at_b = (1.0, 0.0, 0.0) if k == 3 else None
            m.joint(f"j{k}", ends[k], ends[k + 1], Revolute(at=at, armature=float(k == own)), at_b=at_b)
        arrays = CompiledMechanism(m).data.arrays
        assert arrays.bodies["armature"].sum() == 1.0
        assert len(arrays.cuts) == 1


@needs_compiler
def test_fmus_contain_rotors_whose_parameters_are_set(tmp_path: Path) -> None:
    """Native FMU in co-simulation and model exchange; the inertia follows two parameters."""
    settings = mb.Settings(solver="adams", tolerance=1e-9)
    path = export(GearedDisc(), tmp_path / "disc.fmu", settings, native=True)
    other = GearedDisc(ratio=30.0, rotor=1e-3)
    for kind in ("CoSimulation", "ModelExchange"):
        values = {"ratio": other.ratio, "rotor": other.rotor}
        found = simulate_fmu(
            str(path), stop_time=0.5, output_interval=0.1, fmi_type=kind, start_values=values, relative_tolerance=1e-9
        )
        np.testing.assert_allclose(found["q"], 0.5 * other.acceleration() * found["time"] ** 2, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found["load"], 2.0 * other.acceleration(), rtol=1e-9)


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        (Revolute(armature=-1.0), "armature of joint of body 'b' is -1.0; allowed: finite and not negative"),
        (Revolute(armature=(1.0, 2.0)), "armature of joint of body 'b' is"),
        (Spherical(armature=1.0), "the joint has 3 coordinates; allowed: an armature of a joint of one coordinate"),
    ],
)
def test_what_is_no_armature_is_refused(joint: Any, message: str) -> None:
    m = Mechanism()
    with pytest.raises(UserError, match=message):
        m.body("b", m.ground, joint, mass=1.0)
