"""Flexible bodies in the recursions: identities on random mechanisms, and a beam against its chain of nodal bodies."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fe_models import bracket
from hypothesis import given, settings
from hypothesis import strategies as st
from random_mechanisms import Case, random_inertia, random_rotation

from mbfmu.mechanics import (
    Beam,
    BeamElement,
    CompiledMechanism,
    FlexibleBody,
    Floating,
    Mechanism,
    Revolute,
    SphericalCutJoint,
    Translational,
    Weld,
    add_chain,
)
from mbfmu.mechanics.recursions.aba import forward_dynamics
from mbfmu.mechanics.recursions.dynamics import inverse_dynamics_at_solution, update_kinematics
from mbfmu.mechanics.recursions.rnea import momentum
from mbfmu.util.errors import UserError
from solvers import Options, stepper

TOLERANCE = 1e-9


FRAME = bracket(2.0, young=7e7)
SOLIDS = {
    stiffening: FlexibleBody.from_fe(
        FRAME.M,
        FRAME.K,
        FRAME.nodes,
        {"foot": [0], "corner": [3], "tip": [5]},
        modes=2,
        geometric_stiffness=FRAME.geometric_stiffness if stiffening else None,
    )
    for stiffening in (False, True)
}


def build(seed: int, stiffening: bool, loop: bool) -> Case:
    """A floating body with a beam, on it a beam and a body of finite elements, and rigid bodies on sections of all; a
    loop on request.
    """
    rng = np.random.default_rng(seed)
    m = Mechanism(gravity=rng.normal(size=3))

    def rigid(name: str, parent: Any, joint: Any) -> Any:
        return m.body(
            name, parent, joint, mass=rng.uniform(0.5, 2.0), com=rng.normal(size=3), inertia=random_inertia(rng)
        )

    def placed(kind: Any, **options: Any) -> Any:
        return kind(at=rng.normal(size=3), rotation=random_rotation(rng), **options)

    base = rigid("base", m.ground, placed(Floating))
    first = Beam(
        length=2.0,
        mass=3.0,
        bending_stiffness=40.0,
        modes=3,
        elements=4,
        ends=("clamped", "free"),
        stiffening=stiffening,
    )
    second = Beam(length=1.5, mass=1.0, bending_stiffness=20.0, modes=2, elements=3)
    arm = m.flexible_body("arm", base, placed(Revolute, axis=rng.normal(size=3)), first)
    rigid("hung", arm.section(1.1), placed(Revolute, axis=rng.normal(size=3)))
    strut = m.flexible_body("strut", arm.section(2.0), placed(Translational, axis=rng.normal(size=3)), second)
    solid = m.flexible_body("solid", arm.section(0.6), placed(Revolute, axis=rng.normal(size=3)), SOLIDS[stiffening])
    rigid("corner", solid.section("corner"), placed(Revolute, axis=rng.normal(size=3)))
    rigid("end", solid.section("tip"), placed(Weld))
    tip = rigid("tip", strut.section(1.5), placed(Revolute, axis=rng.normal(size=3)))
    if loop:
        m.cut("loop", SphericalCutJoint(at_a=rng.normal(size=3), at_b=rng.normal(size=3)), tip, arm.section(0.4))
    for body in m.bodies[1:]:
        for axis in "xyz":
            m.output(f"{body.name}.r{axis}", body.position(axis, (0.3, -0.2, 0.5)))
            m.output(f"{body.name}.v{axis}", body.velocity(axis, (0.3, -0.2, 0.5)))
            m.output(f"{body.name}.a{axis}", body.point_acceleration(axis, (0.3, -0.2, 0.5)))
    compiled = CompiledMechanism(m)
    q = compiled.assembly.start_positions()
    n = compiled.system.n
    amplitudes = np.array([".mode." in name for name in compiled.system.coordinate_names])
    # Bending is small: the theory is of second order. From 0.05 m on its mass matrix may be indefinite.
    size = np.where([name.startswith("solid") for name in compiled.system.coordinate_names], 0.001, 0.03)
    compiled.system.apply(q, np.where(amplitudes, size * rng.uniform(-1.0, 1.0, n), rng.normal(size=n)))
    return Case(compiled, 0.0, q, 0.5 * rng.normal(size=n), rng.normal(size=n))


seeds = st.integers(0, 2**32 - 1)


def agree(a: Any, b: Any) -> None:
    """Agree to the tolerance, relative to the larger of 1 and the values."""
    size = max(1.0, float(np.abs(a).max(initial=0.0)), float(np.abs(b).max(initial=0.0)))
    np.testing.assert_allclose(a, b, rtol=0, atol=TOLERANCE * size)


@settings(deadline=None, max_examples=20)
@given(seeds, st.booleans())
def test_mass_matrix_inverse_dynamics_and_articulated_body_agree(seed: int, stiffening: bool) -> None:
    case = build(seed, stiffening, loop=False)
    system, data = case.compiled.system, case.compiled.data
    terms = system.allocate_terms()
    system.fill(0.0, case.q, case.v, terms)
    np.testing.assert_array_equal(terms.M, terms.M.T)
    inverse_dynamics_at_solution(0.0, case.q, case.v, case.a, np.zeros(0), case.compiled.kernel_data)
    agree(data.state.tau, terms.M @ case.a + terms.h)
    update_kinematics(0.0, case.q, case.v, *case.compiled.kernel_data)
    assert forward_dynamics(*case.compiled.kernel_data) == 0
    agree(terms.M @ data.state.a, -terms.h)


@settings(deadline=None, max_examples=20)
@given(seeds, st.booleans())
def test_kinetic_energy_is_the_mass_matrix_form_and_power_is_its_rate(seed: int, stiffening: bool) -> None:
    """Along v' = a the power of M a + h is the rate of the energy, strain and weight included."""
    case = build(seed, stiffening, loop=False)
    compiled, system = case.compiled, case.compiled.system
    terms = system.allocate_terms()
    system.fill(0.0, case.q, case.v, terms)
    kinetic = compiled.energy(0.0, case.q, case.v) - compiled.energy(0.0, case.q, 0.0 * case.v)
    agree(kinetic, 0.5 * case.v @ terms.M @ case.v)
    power = case.v @ (terms.M @ case.a + terms.h)
    twin = compiled.complex_system()
    complex_terms = twin.allocate_terms(complex)
    h = 1e-30
    q, v = case.q.astype(complex), case.v + 1j * h * case.a
    twin.apply(q, 1j * h * case.v)
    rate = twin_energy(compiled, q, v).imag / h
    agree(power, rate)
    twin.fill(0.0, q, v, complex_terms)
    agree(complex_terms.M.real, terms.M)


def twin_energy(compiled: Any, q: Any, v: Any) -> complex:
    """Energy of the mechanism on complex numbers."""
    from mbfmu.mechanics.recursions.dynamics import energy

    return complex(energy(0.0, q, v, compiled.complex_system().pinned_data))


@settings(deadline=None, max_examples=20)
@given(seeds, st.booleans())
def test_velocities_and_accelerations_of_all_points_are_the_rates_of_positions(seed: int, stiffening: bool) -> None:
    case = build(seed, stiffening, loop=False)
    compiled, h = case.compiled, 1e-30
    system = compiled.complex_system()
    q, v = case.q.astype(complex), case.v + 1j * h * case.a
    system.apply(q, 1j * h * case.v)
    out = compiled.observe_complex(system, 0.0, q, v, case.a.astype(complex), np.zeros(0, complex))
    values = dict(zip((o.name for o in compiled.outputs), out, strict=True))
    for name, value in values.items():
        body, _, what = name.rpartition(".")
        if what[0] == "r":
            agree(value.imag / h, values[f"{body}.v{what[1]}"].real)
        elif what[0] == "v":
            agree(value.imag / h, values[f"{body}.a{what[1]}"].real)


@settings(deadline=None, max_examples=20)
@given(seeds, st.booleans())
def test_constraint_jacobian_and_gamma_are_derivatives(seed: int, stiffening: bool) -> None:
    case = build(seed, stiffening, loop=True)
    compiled, h = case.compiled, 1e-30
    system = compiled.complex_system()
    terms = system.allocate_terms(complex)
    q, v = case.q.astype(complex), case.v + 1j * h * case.a
    system.apply(q, 1j * h * case.v)
    system.fill(0.0, q, v, terms)
    agree(terms.Phi.imag / h, terms.J.real @ case.v)
    agree((terms.J @ v).imag / h, terms.J.real @ case.a - terms.gamma.real)


@settings(deadline=None, max_examples=20)
@given(seeds)
def test_momentum_of_a_free_mechanism_changes_by_its_weight(seed: int) -> None:
    case = build(seed, stiffening=False, loop=False)
    compiled, system = case.compiled, case.compiled.system
    gravity = compiled.data.arrays.world["gravity"][0].copy()
    compiled.data.arrays.world["gravity"][0] = 0.0
    run = stepper("adams", system, 0.0, case.q, 0.2 * case.v, Options(rtol=1e-10))
    before, after = np.zeros(6), np.zeros(6)
    for out in (before, after):
        update_kinematics(run.t, run.q, run.v, *compiled.kernel_data)
        momentum(*compiled.kernel_data, out)
        run.advance(0.1)
    compiled.data.arrays.world["gravity"][0] = gravity
    np.testing.assert_allclose(after, before, atol=1e-6)


def cantilever(elements: int) -> float:
    """Tip deflection under gravity of a chain of nodal bodies, at rest."""
    from mbfmu.modeling import Model
    from mbfmu.steady.equilibrium import build_problem

    class Chain(Model):
        name = "chain"

        def build(self) -> Mechanism:
            m = Mechanism(gravity=(0.0, -9.81, 0.0))
            nodes = add_chain(
                m,
                "beam",
                m.ground,
                Revolute(drive=0.0),
                length=1.0,
                mass=0.1,
                axial=1e5,
                bending_stiffness=10.0,
                elements=elements,
            )
            m.output("tip", nodes[-1].position("y"))
            return m

    return build_problem(Chain()).solve().outputs["tip"]


def test_a_chain_sags_as_a_cantilever() -> None:
    """w = q L^4 / (8 E I), less a shortening of second order in w / L."""
    exact = -0.1 * 9.81 / (8.0 * 10.0)
    errors = [abs(cantilever(n) / exact - 1.0) for n in (4, 8, 24)]
    assert errors[1] < 6e-3
    assert errors[0] / errors[1] > 3.0
    assert errors[2] < 6e-4  # more than 60 coordinates


def test_a_beam_and_its_sections_are_refused_by_name_where_they_cannot_be() -> None:
    m = Mechanism()
    beam = Beam(length=1.0, mass=1.0, bending_stiffness=1.0, modes=1)
    with pytest.raises(UserError, match="shape of flexible body 'b' is None"):
        m.flexible_body("b", m.ground, Revolute(), None)  # type: ignore[arg-type]
    elastic = m.flexible_body("b", m.ground, Revolute(), beam)
    with pytest.raises(UserError, match="place on a beam is 2"):
        elastic.section(2.0)
    assert elastic.section(0.5) is elastic.section(0.5)
    with pytest.raises(UserError, match="length of chain 'c' is 0"):
        add_chain(m, "c", m.ground, Revolute(), length=0.0, mass=1.0, axial=1.0, bending_stiffness=1.0)
    with pytest.raises(UserError, match=r"elements of chain 'c' are 2\.5; allowed: whole numbers"):
        add_chain(m, "c", m.ground, Revolute(), length=1.0, mass=1.0, axial=1.0, bending_stiffness=1.0, elements=2.5)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"length": 0.0}, "length of a beam element is 0.0; allowed: finite and greater than zero"),
        ({"axial": float("nan")}, "axial of a beam element is nan; allowed: finite and not negative"),
        ({"torsion": -1.0}, "torsion of a beam element is -1.0; allowed: finite and not negative"),
        ({"bending_y": -2.0}, "bending_y of a beam element is -2.0"),
        ({"bending_z": float("inf")}, "bending_z of a beam element is inf"),
        ({"damping": -0.1}, "damping of a beam element is -0.1"),
    ],
)
def test_what_is_no_beam_element_is_refused_by_name(changes: dict[str, float], said: str) -> None:
    with pytest.raises(UserError, match=said):
        BeamElement(**{"length": 1.0, "axial": 1.0, **changes})
