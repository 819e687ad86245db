"""Motion of bodies of finite elements against the full model, closed forms, and published values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy
from fe_models import block, bracket, straight

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.recursions.dynamics import update_kinematics
from mbfmu.mechanics.recursions.rnea import momentum
from mbfmu.util.errors import UserError
from mbfmu.verification.problems.flexible_bodies import AXIAL, BEAM, FINAL_SPEED, RHO, SPIN_END, Elastica, spun_beam
from solvers import Options, stepper

BLOCK, BRACKET = block(), bracket()
FACES = {"left": BLOCK.face(0, False), "right": BLOCK.face(0, True)}
SOLVERS = ["adams", "radau", "ida", "hybrid"]


def free_block(frame: str) -> tuple[Any, Any, mb.FlexibleBody]:
    """A block that flies freely with a load on one end."""
    body = mb.FlexibleBody.from_fe(BLOCK.M, BLOCK.K, BLOCK.nodes, FACES, modes=2, frame=frame)
    m = mb.Mechanism()
    handle = m.flexible_body("block", m.ground, mb.Floating(at=(0.3, -0.2, 0.5)), body)
    m.output("right", handle.section("right").position("x"))
    m.output("energy", m.energy)
    return CompiledMechanism(m), handle, body


@pytest.mark.parametrize("frame", ["left", "center"])
def test_kinetic_energy_and_momentum_are_those_of_all_elements(frame: str) -> None:
    """Nodal velocities in the mass matrix of the full model, which contains rigid-body motions exactly."""
    compiled, handle, body = free_block(frame)
    rng, data = np.random.default_rng(1), compiled.data
    q = compiled.assembly.start_positions()
    n = compiled.system.n
    compiled.system.apply(q, np.r_[rng.normal(size=6), 0.05 * rng.normal(size=n - 6)])
    v = rng.normal(size=n)
    kinetic = compiled.energy(0.0, q, v) - compiled.energy(0.0, q, 0.0 * v)
    update_kinematics(0.0, q, v, *compiled.kernel_data)
    here, p = data.state.bodies[handle.body.index], q[-body.modes :]
    A, Y = here["A"], here["Y"]
    x, u = body.displaced(p) @ A.T, (body.shapes @ v[-body.modes :]) @ A.T
    velocities = Y[:3] + np.cross(Y[3:], x) + u
    momenta = (BLOCK.M @ velocities.ravel()).reshape(-1, 3)
    assert kinetic == pytest.approx(0.5 * np.sum(momenta * velocities), rel=1e-12)
    found = np.zeros(6)
    momentum(*compiled.kernel_data, found)
    np.testing.assert_allclose(found[:3], momenta.sum(axis=0), rtol=1e-11)
    np.testing.assert_allclose(found[3:], np.cross(x + here["r"], momenta).sum(axis=0), rtol=1e-10)


@pytest.mark.parametrize("frame", ["left", "center"])
def test_a_tumbling_body_keeps_momentum_and_energy(frame: str) -> None:
    compiled, _, _ = free_block(frame)
    v = np.zeros(compiled.system.n)
    v[:6] = 0.3, -0.1, 0.2, 6.0, 9.0, -4.0
    v[6] = 0.5
    run = stepper("adams", compiled.system, 0.0, compiled.assembly.start_positions(), v, Options(rtol=1e-10))
    found = []
    for _ in range(2):
        update_kinematics(run.t, run.q, run.v, *compiled.kernel_data)
        out = np.zeros(6)
        momentum(*compiled.kernel_data, out)
        found.append([*out, compiled.energy(run.t, run.q, run.v)])
        run.advance(0.5)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-7, atol=1e-8)


DIRECTION = np.array([1.0, 2.0, -1.0]) / np.sqrt(6.0)


def loaded_bracket(amplitude: float, size: float = 1.0) -> mb.Mechanism:
    """A bracket on the ground, all modes, with an oscillating force and moment on its tip."""
    frame = bracket(size)
    body = mb.FlexibleBody.from_fe(frame.M, frame.K, frame.nodes, {"foot": [0], "tip": [5]}, modes=24)
    m = mb.Mechanism()
    handle = m.flexible_body("bracket", m.ground, mb.Weld(), body)
    tip, swing = handle.section("tip"), mb.Harmonic(amplitude=amplitude, frequency=40.0 / size)
    m.force("push", mb.PointForce(axis=DIRECTION, magnitude=swing), tip)
    m.force(
        "twist",
        mb.Torque(axis="x", magnitude=mb.Harmonic(amplitude=0.1 * size * amplitude, frequency=40.0 / size)),
        tip,
    )
    for axis in "xyz":
        m.output(f"tip.{axis}", m.relative_position(tip, handle.body, axis))
    m.output("energy", m.energy)
    return m


def full_response(amplitude: float, times: Any) -> Any:
    """Displacements (times, 3) of the tip by SciPy, from the matrices of the full model with the foot clamped."""
    free = slice(6, None)
    M, K = BRACKET.M[free, free], BRACKET.K[free, free]
    load = np.zeros(len(M))
    load[-6:] = *DIRECTION, 0.1, 0.0, 0.0
    inverse, w = np.linalg.inv(M), 2.0 * np.pi * 40.0

    def rate(t: float, y: Any) -> Any:
        u, v = np.split(y, 2)
        return np.r_[v, inverse @ (amplitude * load * np.sin(w * t) - K @ u)]

    start = np.zeros(2 * len(M))
    found = scipy.integrate.solve_ivp(rate, (0.0, times[-1]), start, "DOP853", times, rtol=1e-9, atol=1e-16)
    return found.y[len(M) - 6 : len(M) - 3].T


@pytest.fixture(scope="module")
def reference() -> Any:
    return full_response(1e-3, np.linspace(0.0, 0.02, 21))


@pytest.mark.parametrize("solver", SOLVERS)
def test_small_motion_is_that_of_the_full_model_with_every_solver(solver: str, reference: Any) -> None:
    result = mb.simulate(loaded_bracket(1e-3), 0.02, interval=0.001, solver=solver, tolerance=1e-9)
    assert not result.diagnostics
    found = np.column_stack([result[f"tip.{axis}"] for axis in "xyz"]) - (BRACKET.nodes[5] - BRACKET.nodes[0])
    np.testing.assert_allclose(found, reference, rtol=0, atol=2e-5 * np.abs(reference).max())


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_another_size_gives_the_same_motion(size: float) -> None:
    one = mb.simulate(loaded_bracket(10.0), 0.02, interval=0.004, solver="adams", tolerance=1e-8)
    other = mb.simulate(
        loaded_bracket(10.0 * size**2, size), 0.02 * size, interval=0.004 * size, solver="adams", tolerance=1e-8
    )
    assert not other.diagnostics
    for axis in "xyz":
        np.testing.assert_allclose(other[f"tip.{axis}"] / size, one[f"tip.{axis}"], rtol=0, atol=1e-8)


def test_damping_ratios_are_those_of_the_modes() -> None:
    frame = bracket()
    body = mb.FlexibleBody.from_fe(frame.M, frame.K, frame.nodes, {"foot": [0]}, modes=3, damping=[0.01, 0.02, 0.03])
    m = mb.Mechanism()
    m.flexible_body("bracket", m.ground, mb.Weld(), body)
    found = mb.equilibrium(m).modes
    exact = body.frequencies * (-body.damping + 1j * np.sqrt(1.0 - body.damping**2))
    np.testing.assert_allclose([mode.eigenvalue for mode in found], exact, rtol=1e-9)


def rotating(eta: float, stiffening: bool, elements: int = 12) -> Any:
    """Modes about the steady rotation of a cantilever of unit length, mass and bending stiffness."""
    beam = straight(1.0, elements, slender=1e6)
    stiffness = beam.geometric_stiffness if stiffening else None
    body = mb.FlexibleBody.from_fe(beam.M, beam.K, beam.nodes, {"hub": [0]}, modes=12, geometric_stiffness=stiffness)
    m = mb.Mechanism()
    m.flexible_body("arm", m.ground, mb.Revolute(drive=mb.Polynomial((0.0, eta))), body)
    return mb.equilibrium(m)


def error_of_squares(eta: float, stiffening: bool, flap: float) -> tuple[float, float]:
    """Largest error of the squared frequencies of the first modes in and across the plane of rotation."""
    errors = []
    for elements in (8, 16):
        found = sorted(mode.frequency for mode in rotating(eta, stiffening, elements).modes)[:2]
        errors.append(float(np.abs(np.square(found) - [flap**2 - eta**2, flap**2]).max()))
    return errors[0], errors[1]


@pytest.mark.parametrize(("eta", "flap"), [(3.0, 4.7973), (6.0, 7.3604)])
def test_rotating_cantilever(eta: float, flap: float) -> None:
    """Flapping frequencies of Wright, Smith, Thresher and Wang (1982); in the plane of rotation eta^2 less. Errors have
    the order of the square of the element length.
    """
    coarse, fine = error_of_squares(eta, True, flap)
    assert fine < 0.3 * coarse < 0.3 * 0.5 * (eta / 8) ** 2


def test_rotating_cantilever_that_does_not_stiffen() -> None:
    """The modes of rest, in the plane of rotation less eta^2: beyond 3.516 the motion is unstable."""
    coarse, fine = error_of_squares(3.0, False, 3.51602)
    assert fine < 0.3 * coarse < 0.3 * 0.5 * (3.0 / 8) ** 2
    assert rotating(4.0, stiffening=False).stability == "unstable"


def column(acceleration: float, thrust: float) -> Any:
    """A vertical cantilever of unit length, mass and bending stiffness, under its weight and a force on its tip."""
    beam = straight(1.0, 10, slender=1e6)
    parts = {"foot": [0], "tip": [10]}
    body = mb.FlexibleBody.from_fe(
        beam.M, beam.K, beam.nodes, parts, modes=8, geometric_stiffness=beam.geometric_stiffness
    )
    m = mb.Mechanism(gravity=(-acceleration, 0.0, 0.0))
    handle = m.flexible_body("column", m.ground, mb.Weld(), body)
    m.force("thrust", mb.PointForce(axis="x", magnitude=-thrust), handle.section("tip"))
    return mb.equilibrium(m).stability


def test_a_column_buckles_under_its_weight_and_under_a_force() -> None:
    """Greenhill (1881), m g L^2 / (E I) = 7.8373; Euler, pi^2 / 4."""
    assert [column(part * 7.8373, 0.0) for part in (0.99, 1.01)] == ["undamped", "unstable"]
    assert [column(0.0, part * np.pi**2 / 4.0) for part in (0.99, 1.01)] == ["undamped", "unstable"]


def test_bodies_and_interfaces_are_refused_by_name_where_they_cannot_be() -> None:
    m = mb.Mechanism()
    body = mb.FlexibleBody.from_fe(BLOCK.M, BLOCK.K, BLOCK.nodes, FACES, modes=2)
    handle = m.flexible_body("block", m.ground, mb.Revolute(), body)
    assert handle.section("left") is handle.body
    assert handle.section("right") is handle.section("right")
    with pytest.raises(UserError, match="interface is 'top'; allowed: 'left', 'right'"):
        handle.section("top")
    with pytest.raises(UserError, match="deflection of flexible body 'block'"):
        handle.deflection(0.1)
    with pytest.raises(UserError, match=r"turn of body .* requires parallel revolute joints"):
        m.turn(handle.section("right"))
    free = mb.FlexibleBody.from_fe(BLOCK.M, BLOCK.K, BLOCK.nodes, FACES, modes=2, frame="center")
    with pytest.raises(UserError, match="joint of flexible body 'free' is Weld"):
        m.flexible_body("free", m.ground, mb.Weld(), free)


def test_a_beam_that_is_spun_up_bends_back_and_stretches() -> None:
    """Deflection of the inextensible elastica; the steady extension is rho w^2 L^3 / (3 E A)."""
    result = mb.simulate(spun_beam(), SPIN_END, interval=0.25, solver="radau", tolerance=1e-6)
    assert not result.diagnostics
    early = result.t <= 8.0
    beam = Elastica(3)
    exact = scipy.integrate.solve_ivp(
        beam.right, (0.0, 8.0), np.zeros(6), "Radau", result.t[early], rtol=1e-6, atol=1e-9
    )
    deflection = beam.deflection(exact.t, exact.y)[0]
    np.testing.assert_allclose(result["y"][early], deflection, rtol=0, atol=0.01 * np.abs(deflection).max())
    stretch = RHO * FINAL_SPEED**2 * BEAM**3 / (3.0 * AXIAL)
    assert np.mean(result["x"][result.t > 16.0]) - BEAM == pytest.approx(stretch, rel=2e-3)


def test_amplitudes_start_as_given_and_keep_their_energy() -> None:
    """All modes of a clamped bracket: strain energy k p^2 / 2 and kinetic energy m p'^2 / 2."""
    body = mb.FlexibleBody.from_fe(BRACKET.M, BRACKET.K, BRACKET.nodes, {"foot": [0], "tip": [5]}, modes=24)
    start, rate = np.linspace(1e-5, 2e-5, body.modes), np.linspace(2e-2, 1e-2, body.modes)
    m = mb.Mechanism()
    m.flexible_body("bracket", m.ground, mb.Weld(), body, start=tuple(start), rate=tuple(rate))
    compiled = CompiledMechanism(m)
    q, v = compiled.assembly.assemble(0.0)
    energy = 0.5 * body.modal_masses @ (rate**2 + (body.frequencies * start) ** 2)
    assert compiled.energy(0.0, q, v) == pytest.approx(energy, rel=1e-9)
    m = mb.Mechanism()
    m.flexible_body("bracket", m.ground, mb.Weld(), body, start=(0.0, 1.0))
    with pytest.raises(UserError, match=r"bracket\.mode"):
        mb.simulate(m, 1e-3)


def test_a_rod_in_a_loop_starts_undeformed_keeps_the_energy_and_is_rigid_if_it_is_stiff() -> None:
    """Slider-crank: the slider is at r cos(phi) + sqrt(l^2 - (r sin(phi))^2); the given angles do not close it."""
    found = {}
    for stiffness in (1e4, 20.0):
        rod = straight(1.0, 4, stiffness=stiffness)
        body = mb.FlexibleBody.from_fe(rod.M, rod.K, rod.nodes, {"crank": [0], "slider": [4]}, modes=2)
        m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
        crank = m.body("crank", m.ground, mb.Revolute(start=0.3, rate=5.0), **mb.rod(mass=1.0, length=0.3))
        handle = m.flexible_body("rod", crank, mb.Revolute(at=(0.3, 0.0, 0.0), start=-0.4), body)
        slider = m.body("slider", handle.section("slider"), mb.Revolute(), mass=0.5, inertia=(1e-3, 1e-3, 1e-3))
        m.cut("guide", mb.TranslationalCutJoint(axis="x"), m.ground, slider)
        for name, sensor in (("phi", crank.angle()), ("x", slider.position("x")), ("energy", m.energy)):
            m.output(name, sensor)
        result = mb.simulate(m, 1.0, interval=0.05, solver="adams", tolerance=1e-8)
        assert {d.code for d in result.diagnostics} == {"changed-start"}
        np.testing.assert_allclose(result["energy"], result["energy"][0], rtol=1e-7)
        phi = result["phi"]
        rigid = 0.3 * np.cos(phi) + np.sqrt(1.0 - (0.3 * np.sin(phi)) ** 2)
        found[stiffness] = result["x"] - rigid, result["energy"][0]
    (stiff, energy), (soft, other) = found.values()
    assert energy == pytest.approx(other, rel=1e-9)
    assert np.abs(stiff).max() < 1e-6
    assert np.abs(soft).max() > 1e-3


def test_a_loop_that_only_a_deformation_closes_is_closed_by_it() -> None:
    """The force on the tip of a cantilever is 3 E I w / L^3."""
    beam = straight(0.5, 3, stiffness=40.0)
    body = mb.FlexibleBody.from_fe(beam.M, beam.K, beam.nodes, {"root": [0], "tip": [3]}, modes=1)
    m = mb.Mechanism()
    handle = m.flexible_body("beam", m.ground, mb.Weld(), body)
    slider = m.body("slider", m.ground, mb.Translational(axis="y", at=(0.5, 0.0, 0.0), drive=1e-3), mass=0.1)
    m.cut("tip", mb.SphericalCutJoint(), handle.section("tip"), slider)
    m.output("force", slider.effort())
    assert mb.equilibrium(m).outputs["force"] == pytest.approx(3.0 * 40.0 * 1e-3 / 0.5**3, rel=1e-5)
