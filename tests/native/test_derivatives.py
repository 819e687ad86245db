"""Directional, adjoint and time derivatives of native FMUs.

References are closed forms, the state matrices of `mbfmu linearize`, and central differences of sixth order of the
functions themselves: derivatives are those of the same FMU's functions.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from ctypes import c_double, c_int, c_size_t, c_uint
from math import sin
from typing import Any

import mechanisms as loops
import numpy as np
import pytest
from binding import DISCARD, ERROR, OK, Binary
from exchange_models import REGULAR, ExportedModels, many_loops, spinning_top
from importer import Importer, importing
from linear_importer import Linear, Third, directional, on_the_constraints, relative_errors
from numpy.typing import NDArray
from random_mechanisms import MOVING, build

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.sheet import Sheet
from mbfmu.mechanics import (
    Floating,
    Input,
    JointForce,
    JointSpring,
    Mechanism,
    Revolute,
    Spherical,
    SphericalCutJoint,
    Translational,
    rod,
)
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import host
from mbfmu.steady.equilibrium import equilibrium

Array = NDArray[np.float64]
G = 9.81

pytestmark = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> ExportedModels:
    """FMUs of the models."""
    return ExportedModels(tmp_path_factory)


@pytest.fixture(scope="module")
def binary(models: ExportedModels) -> Callable[[str, Any], Binary]:
    """What loads the FMU of a model once."""
    return models.load


# ---- the same function by differences ------------------------------------------------------------------------------


def driven_loop() -> Mechanism:
    """A spatial four-bar whose base an input moves, with a torque as another one: its constraints depend on inputs."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    along = Input(name="x", unit="m", rate_name="x.rate", acceleration_name="x.acceleration")
    base = m.body("base", m.ground, Translational(axis="x", drive=along), mass=1.0)
    crank = m.body("crank", m.ground, Revolute(axis="z", start=0.6, fixed=True), **rod(mass=1.0, length=0.5))
    hinge, com = Revolute(axis="x", at=(1.2, 0.0, 0.6), start=0.3), (0.0, 0.4, 0.0)
    rocker = m.body("rocker", base, hinge, mass=1.2, com=com, inertia=(0.08, 0.01, 0.08))
    ball, com = Spherical(at=(0.5, 0.0, 0.0)), (0.725, 0.05, 0.02)
    coupler = m.body("coupler", crank, ball, mass=1.5, com=com, inertia=(0.02, 0.26, 0.27))
    cut = m.cut("ball", SphericalCutJoint(at_a=(1.45, 0.0, 0.0), at_b=(0.0, 0.8, 0.0)), coupler, rocker)
    motor = m.force("motor", JointForce(magnitude=Input(name="torque", unit="N.m", start=2.0)), crank)
    m.output("angle", crank.angle())
    m.output("bearing", cut.force("x"))
    m.output("drive", base.effort())
    m.output("motor", motor.effort())
    m.output("acceleration", rocker.acceleration())
    m.output("point", coupler.position("y", (0.7, 0.0, 0.0)))
    m.output("energy", m.energy)
    return m


def bricard() -> Mechanism:
    """A loop with redundant constraints, and their forces as outputs."""
    m = loops.bricard().mechanism
    for handle in m.cuts:
        for row in handle.cut.rows:
            m.output(f"{handle.name}.{row}", handle.force(row))
    return m


def random_tree(seed: int) -> Mechanism:
    """A random tree with all kinds of forces; quaternions among its joints."""
    rng = np.random.default_rng(seed)
    kinds = [MOVING[k] for k in rng.integers(0, len(MOVING), 3)]
    mechanism: Mechanism = build(seed, [*kinds, Spherical, Floating], [], False, True).compiled.mechanism
    return mechanism


CASES: dict[str, Callable[[], Mechanism]] = {
    **{name: make for name, (make, _) in REGULAR.items() if name != "redundant"},
    "redundant": bricard,
    "spinning top": spinning_top,
    "driven loop": driven_loop,
    "near miss": lambda: loops.parallelogram(1e-2, start=30.0).mechanism,
    "ladder": lambda: loops.ladder(3).mechanism,
    "squeezer": lambda: loops.squeezer().mechanism,
    "many loops": lambda: many_loops(31, torque=True, moved=True),
    **{f"random tree {seed}": lambda seed=seed: random_tree(seed) for seed in range(6)},  # type: ignore[misc]
}


CONSTANT = {"governor": ("spindle.drive",), "pendulum": ("crank.drive",)}  # inputs that cannot be changed


QUICK = ("four-bar", "spatial four-bar", "governor", "redundant", "spinning top", "driven loop", "random tree 0")
MARKED = [pytest.param(name, marks=() if name in QUICK else pytest.mark.campaign) for name in CASES]


@pytest.mark.parametrize("name", MARKED)
def test_derivatives_are_those_of_the_functions(name: str, binary: Callable[[str, Any], Binary]) -> None:
    with importing(binary(name, CASES[name]())) as own:
        own.start()
        linear, rng = Linear(own, CONSTANT.get(name, ())), np.random.default_rng(7)
        spread = 1e-3 if name in ("near miss", "squeezer") else 0.05
        x, u = on_the_constraints(own, spread), rng.normal(size=len(linear.inputs))
        linear.evaluate(0.0, x, u)
        own.event()  # inputs may have moved the constraints
        x = own.states()
        found, size = linear.matrix(), np.concatenate((own.nominals(), np.ones(len(u))))
        step = 3e-5 if spread < 0.05 else 3e-4 if name == "many loops" else 2e-3
        expected = linear.differences(0.0, x, u, step * size)
    known = np.isfinite(expected).all(axis=1)
    assert np.isfinite(found).all()
    errors = relative_errors(found[known], expected[known])
    # eliminated loops are closed up to 1e-13: forces of some 100 N times this, divided by the step, remain
    bound = 1e-6 if name == "many loops" else 1e-8
    assert errors.max() < bound, dict(zip([*linear.slopes, *own.outputs], errors, strict=False))


@pytest.mark.parametrize("name", ["spatial four-bar", "redundant"])
def test_the_error_off_the_constraints_is_of_the_order_of_the_distance(name: str, binary: Any) -> None:
    with importing(binary(name, CASES[name]())) as own:
        own.start()
        linear, none = Linear(own), np.zeros(0)
        x = on_the_constraints(own, 0.05)
        direction = np.random.default_rng(3).normal(size=len(x))
        for d in (1e-3, 1e-5):
            linear.evaluate(0.0, x + d * direction, none)
            found = linear.matrix()
            expected = linear.differences(0.0, x + d * direction, none, np.full(len(x), 2e-3))
            known = np.isfinite(expected).all(axis=1)
            assert relative_errors(found[known], expected[known]).max() < 100.0 * d


# ---- closed forms and state matrices -------------------------------------------------------------------------------


def damped_pendulum() -> Mechanism:
    """A rod on a hinge with a damper, turned by a torque that is an input."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    swing = m.body("swing", m.ground, Revolute(start=-1.2), **rod(mass=2.0, length=0.8))
    m.force("damper", JointSpring(damping=0.3), swing)
    m.force("motor", JointForce(magnitude=Input(name="torque", unit="N.m", start=1.5)), swing)
    m.output("acceleration", swing.acceleration())
    return m


def test_a_pendulum_in_closed_form(binary: Any) -> None:
    inertia, weight, x = 2.0 * 0.8**2 / 3.0, 2.0 * G * 0.4, np.array([0.7, 1.9])
    with importing(binary("damped pendulum", damped_pendulum()), ["acceleration"]) as own:
        own.start()
        linear = Linear(own)
        own.place(0.0, x)
        found = linear.matrix()
    row = np.array([weight * sin(x[0]), -0.3, 1.0]) / inertia
    np.testing.assert_allclose(found, [[0.0, 1.0, 0.0], row, row], rtol=1e-13, atol=1e-13)


def two_masses() -> Mechanism:
    """Two masses on springs in a row, with a force that is an input on the second one."""
    m = Mechanism()
    first = m.body("first", m.ground, Translational(axis="x"), mass=2.0)
    second = m.body("second", first, Translational(axis="x"), mass=0.5)
    m.force("spring", JointSpring(stiffness=300.0, damping=1.5), first)
    m.force("other", JointSpring(stiffness=40.0), second)
    m.force("push", JointForce(magnitude=Input(name="force", unit="N")), second)
    return m


def test_two_masses_in_closed_form(binary: Any) -> None:
    """The second coordinate is that relative to the first body."""
    with importing(binary("two masses", two_masses()), []) as own:
        own.start()
        found = Linear(own).matrix()
    K, D = np.diag([300.0, 40.0]), np.diag([1.5, 0.0])
    inverse = np.linalg.inv([[2.5, 0.5], [0.5, 0.5]])
    expected = np.block([[np.zeros((2, 2)), np.eye(2), np.zeros((2, 1))], [-inverse @ K, -inverse @ D, inverse[:, 1:]]])
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-11)


@pytest.mark.parametrize("model", [Governor(), Governor(driven=False), FourBar()], ids=["driven", "free", "four-bar"])
def test_state_matrices_of_a_steady_state_are_those_of_mbfmu_linearize(model: Any, models: ExportedModels) -> None:
    """In directions that the constraints allow: by the independent coordinates, as in linearize."""
    steady = equilibrium(model)
    expected, system = steady.state_space, steady.compiled.system
    f = expected.coordinates.shape[1]
    chosen = [list(system.coordinate_names).index(name) for name in expected.states[:f]]
    own_binary = models.load(f"{model.name} {getattr(model, 'driven', '')} at rest", model)
    with importing(own_binary) as own:
        own.start()
        linear, nq = Linear(own), system.nq
        own.place(0.0, np.concatenate((steady.q, steady.v)))
        own.event()
        for k in range(f):
            dq = expected.coordinates[:, k]
            seed = np.concatenate((dq, np.zeros(system.n), np.zeros(len(linear.inputs))))
            rates = linear.along(seed)[:nq]  # velocities that the constraints allow with these positions
            for dv in (rates, rates + dq):
                seed = np.concatenate((dq, dv, np.zeros(len(linear.inputs))))
                found = linear.along(seed)
                np.testing.assert_allclose(found[:nq], dv, atol=1e-10 * max(1.0, np.abs(dv).max()))
                z = np.concatenate((dq[chosen], dv[chosen]))
                a = expected.free[f:] @ z
                np.testing.assert_allclose(found[nq:][chosen], a, atol=1e-10 * np.abs(expected.free).max())
                seen = expected.C[:, : 2 * f] @ z
                np.testing.assert_allclose(
                    found[2 * nq : 2 * nq + len(seen)], seen, atol=1e-9 * np.abs(expected.C).max()
                )


# ---- identities ----------------------------------------------------------------------------------------------------


def test_derivatives_are_linear_in_the_direction(binary: Any) -> None:
    rng = np.random.default_rng(5)
    with importing(binary("driven loop", driven_loop())) as own:
        own.start()
        linear = Linear(own)
        x, y = rng.normal(size=(2, own.count + len(linear.inputs)))
        whole, parts = linear.along(2.0 * x - 3.0 * y), 2.0 * linear.along(x) - 3.0 * linear.along(y)
        np.testing.assert_allclose(whole, parts, atol=1e-12 * np.abs(parts).max())
        columns = linear.matrix()
        np.testing.assert_allclose(whole, columns @ (2.0 * x - 3.0 * y), atol=1e-12 * np.abs(parts).max())
        one = linear.along(x, linear.outputs[:1])
        assert one == linear.along(x)[len(linear.slopes)]


def test_reading_and_evaluating_in_between_changes_nothing(binary: Any) -> None:
    with importing(binary("driven loop", driven_loop())) as own:
        own.start()
        linear, x = Linear(own), on_the_constraints(own, 0.02)
        own.place(0.0, x)
        before, slope = linear.matrix(), own.derivatives(0.0, x)
        own.place(0.0, 1.01 * x)
        linear.along(np.ones(own.count + len(linear.inputs)))
        own.place(0.0, x)
        out = own.read(0.0, x)
        np.testing.assert_array_equal(linear.matrix(), before)
        np.testing.assert_array_equal(own.derivatives(0.0, x), slope)
        np.testing.assert_array_equal(own.read(0.0, x), out)


def test_nothing_is_declared_independent_that_is_not(models: ExportedModels) -> None:
    """Dependencies of the model description contain every derivative that is not zero."""
    own_binary = models.load("driven loop", driven_loop())
    with importing(own_binary) as own:
        own.start()
        linear = Linear(own)
        on_the_constraints(own, 0.02)
        found = linear.matrix()
    known = [*linear.states, *linear.inputs]
    for unknown in own_binary.description.outputs:
        row = found[linear.unknowns.index(unknown.variable.valueReference)]
        told = {v.valueReference for v in unknown.dependencies}
        assert {known[k] for k in np.flatnonzero(np.abs(row) > 1e-9)} <= told


def test_branches_that_cross_have_no_derivatives(binary: Any) -> None:
    with importing(binary("crossing", loops.parallelogram(start=10.0).mechanism)) as own:
        own.start()
        linear = Linear(own)
        own.place(0.0, np.array([0.0, 0.0, 0.0, 1.0, -1.0, 1.0]))
        status, found = directional(own.fmu, linear.unknowns, linear.states[:1], [1.0])
        assert status == DISCARD
        assert np.isnan(found).all()
        assert "branches of the motion cross" in own.binary.logged[-1][1]


# ---- FMI 3.0, and large trees --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["driven loop", "sheet"])
def test_adjoint_derivatives_are_the_transpose(name: str, models: ExportedModels, tmp_path: Any) -> None:
    model: Any = driven_loop() if name == "driven loop" else Sheet(nx=4, nz=3, grid_outputs=True)
    third = Third(models, f"{name} 3", model, tmp_path)
    rng = np.random.default_rng(2)
    unknowns = [*third.slopes, *(v.valueReference for v in third.outputs)]
    rows = len(third.slopes) + sum(int(np.prod([int(d.start) for d in v.dimensions])) for v in third.outputs)
    knowns = third.states if name == "driven loop" else third.states[:6]
    columns = [third.derivative("Directional", unknowns, knowns, unit, rows) for unit in np.eye(len(knowns))]
    weights = rng.normal(size=rows)
    adjoint = third.derivative("Adjoint", unknowns, knowns, weights, len(knowns))
    expected = np.array(columns) @ weights
    np.testing.assert_allclose(adjoint, expected, atol=1e-12 * np.abs(columns).max() * rows)
    third.fmu.freeInstance()


def test_a_large_tree_by_recursions(binary: Any) -> None:
    """A sheet of plate elements with 180 states: products with the matrix, against differences along the direction."""
    sheet = Sheet(nx=7, nz=5).build()
    with importing(binary("sheet", sheet)) as own:
        own.start()
        linear, rng = Linear(own), np.random.default_rng(4)
        assert own.count == 180
        x, gravity = own.states() + 1e-3 * rng.normal(size=180), np.array([0.0, -G, 0.0])
        for _ in range(3):
            direction, h = rng.normal(size=180), 2e-5
            own.place(0.0, x)
            found = linear.along(np.concatenate((direction, np.zeros(3))))
            expected = np.zeros(len(found))
            for n, w in ((1, 45.0), (2, -9.0), (3, 1.0)):
                ahead, behind = (linear.evaluate(0.0, x + s * n * h * direction, gravity) for s in (1.0, -1.0))
                expected += w * (ahead - behind) / (60.0 * h)
            known = np.isfinite(expected)
            assert np.abs(found - expected)[known].max() < 1e-6 * np.abs(expected[known]).max()


# ---- co-simulation -------------------------------------------------------------------------------------------------


def test_co_simulation_gives_outputs_by_inputs_at_the_communication_point(binary: Any) -> None:
    """A torque and a support: the first changes accelerations and forces at once, the other nothing."""
    own_binary = binary("driven loop", driven_loop())
    fmu, references = (
        own_binary.instantiate(),
        {v.name: v.valueReference for v in own_binary.description.modelVariables},
    )
    outputs = [v.valueReference for v in own_binary.description.modelVariables if v.causality == "output"][:7]
    inputs = [references[name] for name in ("torque", "x", "x.rate", "x.acceleration")]
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    assert fmu.set("Real", inputs[2:3], [0.4]) == OK
    for k in range(20):
        assert fmu.step(0.01 * k, 0.01) == OK
    columns, expected = [], []
    for reference in inputs:
        status, found = directional(fmu, outputs, [reference], [1.0])
        assert status == OK
        columns.append(found)
        (value,), rows = fmu.get("Real", [reference])[1], []
        for moved in (value + 0.5, value - 0.5):
            assert fmu.set("Real", [reference], [moved]) == OK
            rows.append(np.array(fmu.get("Real", outputs)[1]))
        assert fmu.set("Real", [reference], [value]) == OK
        expected.append(rows[0] - rows[1])
    assert np.abs(columns[0]).max() > 1e-2
    np.testing.assert_allclose(columns, expected, atol=1e-10)
    fmu.free()


def test_outputs_have_first_derivatives_by_time(binary: Any) -> None:
    """Of a position and of a rate; that of a force is not available."""
    own_binary = binary("driven loop", driven_loop())
    fmu, known = own_binary.instantiate(), {v.name: v.valueReference for v in own_binary.description.modelVariables}
    assert (
        fmu.set_up(tolerance=1e-10) == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    )
    assert fmu.set("Real", [known["x.rate"]], [0.4]) == OK
    names, h, rows, rates = ["angle", "point", "energy"], 1e-3, [], []
    for k in range(7):
        assert fmu.step(h * k, h) == OK
        rows.append(fmu.get("Real", [known[name] for name in names])[1])
        found = (c_double * 2)()
        asked = (c_uint * 2)(*(known[name] for name in names[:2]))
        assert fmu.call("GetRealOutputDerivatives", asked, c_size_t(2), (c_int * 2)(1, 1), found) == OK
        rates.append(list(found))
    values = np.array(rows)[:, :2]
    expected = (45.0 * (values[4] - values[2]) - 9.0 * (values[5] - values[1]) + values[6] - values[0]) / (60.0 * h)
    np.testing.assert_allclose(rates[3], expected, atol=1e-6)
    status = fmu.call("GetRealOutputDerivatives", (c_uint * 1)(known["bearing"]), c_size_t(1), (c_int * 1)(1), found)
    assert status == DISCARD
    assert np.isnan(found[0])
    status = fmu.call("GetRealOutputDerivatives", (c_uint * 1)(known["angle"]), c_size_t(1), (c_int * 1)(2), found)
    assert status == ERROR
    fmu.free()


def test_wrong_calls_are_errors_with_a_reason(binary: Any) -> None:
    own_binary = binary("driven loop", driven_loop())
    own = Importer(own_binary)
    linear = Linear(own)
    assert directional(own.fmu, linear.outputs[:1], linear.states[:1], [1.0])[0] == ERROR
    own.start()
    for unknowns, knowns, said in (
        (linear.states[:1], linear.states[:1], "as an unknown; allowed: outputs and derivatives"),
        (linear.outputs[:1], linear.slopes[:1], "as a known variable; allowed: inputs and continuous states"),
        ([9999], linear.states[:1], "of another variable as an unknown"),
        (linear.outputs[:1], [own.references["tolerance"]], "of 'tolerance' as a known variable"),
    ):
        assert directional(own.fmu, unknowns, knowns, [1.0])[0] == ERROR
        assert said in own_binary.logged[-1][1]
    assert own.fmu.call("GetDirectionalDerivative", None, c_size_t(1), None, c_size_t(1), None, None) == ERROR
    assert own.fmu.call("GetDirectionalDerivative", None, c_size_t(0), None, c_size_t(0), None, None) == OK
    own.free()
