"""Native FMUs for model exchange: SciPy's solvers, CVode of FMPy and a C program integrate them.

References are exact motions, and formulations and integrators that share nothing with the package (tests/loops).
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from ctypes import byref, c_double, c_size_t
from math import cos, inf, sin
from pathlib import Path
from typing import Any

import fmpy
import mechanisms as loops
import numpy as np
import pytest
from binding import DISCARD, ERROR, OK, WARNING, Binary
from exchange_models import (
    REGULAR,
    ExportedModels,
    cart,
    many_loops,
    pulsed,
    spatial_four_bar,
    spinning_top,
    switched,
)
from fmpy import simulate_fmu
from importer import EventInfo, Importer, importing
from reference import distance, reference
from scipy.integrate import RK45, solve_ivp

from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from fmus.sheet import Sheet
from mbfmu.fmi import export
from mbfmu.mechanics import (
    CompiledMechanism,
    Input,
    Mechanism,
    Revolute,
    Translational,
    rod,
)
from mbfmu.modeling import Model
from mbfmu.modeling.model import as_model
from mbfmu.native import exchange_states
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import host
from mbfmu.session.simulation import Settings

G = 9.81

pytestmark = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> ExportedModels:
    """FMUs of the models."""
    return ExportedModels(tmp_path_factory)


@pytest.fixture(scope="module")
def exported(models: ExportedModels) -> Callable[..., Path]:
    """What exports a model once for a version of FMI."""
    return models.export


@pytest.fixture(scope="module")
def binary(models: ExportedModels) -> Callable[[str, Any], Binary]:
    """What loads the FMU of a model once."""
    return models.load


# ---- motions -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", REGULAR)
def test_motions_are_those_of_a_formulation_by_others(name: str, binary: Callable[[str, Any], Binary]) -> None:
    make, end = REGULAR[name]
    mechanism, times, rtol = make(), np.linspace(0.0, end, 5), 1e-8
    start = CompiledMechanism(make()).assemble()
    exact = reference(mechanism, times, start, tolerance=1e-11)
    assert not exact.ended
    assert exact.trusted_until(1e-7) == end
    with importing(binary(name, make())) as own:
        run = own.integrate(times, rtol, info=own.start())
    off = distance(mechanism, start[1], exact.q, run.x[:, : len(start[0])])
    assert off.max() < 200.0 * rtol
    assert run.warned == 0


@pytest.mark.parametrize("start", [10.0, -20.0])
@pytest.mark.parametrize("rtol", [1e-4, 1e-6])
def test_exact_singular_configurations_are_passed(rtol: float, start: float, binary: Any) -> None:
    case = loops.parallelogram(start=start)
    times = np.array([0.0, 3.0])
    q, v = case.exact(times)  # type: ignore[misc]
    with importing(binary(f"parallelogram {start}", case.mechanism)) as own:
        run = own.integrate(times, rtol, info=own.start())
    assert np.abs(run.x[-1] - np.concatenate((q[-1], v[-1]))).max() < 50.0 * rtol
    assert run.warned == 0
    assert run.evaluations < 700


@pytest.mark.parametrize("name", ["ladder", "row"])
def test_large_mechanisms_with_loops_follow_the_exact_motion(name: str, binary: Any) -> None:
    """All loops of the row are singular at once when it is horizontal, which it passes."""
    case = loops.ladder(21) if name == "ladder" else loops.n_four_bar(31)
    times, rtol = np.array([0.0, 1.0, 2.0]), 1e-6
    q, v = case.exact(times)  # type: ignore[misc]
    with importing(binary(f"large {name}", case.mechanism)) as own:
        assert own.count > 120
        run = own.integrate(times, rtol, info=own.start())
    assert np.abs(run.x - np.hstack((q, v))).max() < 200.0 * rtol
    assert run.warned == 0


@pytest.mark.parametrize("change", [1e-13, 1e-8, 1e-5])
def test_small_velocities_about_rest_are_projected_and_not_discarded(change: float, binary: Any) -> None:
    """Solvers that find a Jacobian by differences make them; most are not possible with the loops."""
    own_binary = binary("large at rest", many_loops(31, torque=True))
    with importing(own_binary) as own:
        own.start()
        x = own.states()
        slope, nv = own.derivatives(0.0, x), len(x) // 2
        assert not x[-nv:].any()
        for moved in range(len(x) - nv, len(x)):
            near = x + change * (np.arange(len(x)) == moved)
            np.testing.assert_allclose(own.derivatives(0.0, near), slope, atol=1e3 * change + 1e-9)


def test_near_misses_stay_on_their_branch(binary: Any) -> None:
    """The linkage misses the singular configuration by random lengths; a jump is off by radians."""
    rng, tried = np.random.default_rng(5), 4
    for k in range(tried):
        eps, start = rng.choice((-1.0, 1.0)) * 10.0 ** rng.uniform(-6.0, -3.0), rng.uniform(15.0, 40.0)
        times = np.array([0.0, 1.5])
        exact = reference(loops.parallelogram(eps, start=start).mechanism, times, tolerance=1e-10)
        assert exact.trusted_until(1e-5) == times[-1]
        with importing(binary(f"near miss {k}", loops.parallelogram(eps, start=start).mechanism)) as own:
            run = own.integrate(times, 1e-4, info=own.start())
        assert np.abs(run.x[-1, :3] - exact.q[-1]).max() < 0.05, (eps, start)
        assert run.warned == 0


def test_quaternions_turn_at_the_same_rate_whatever_their_length(binary: Any) -> None:
    """Precession of a symmetric body without forces, in closed form."""
    rtol, times = 1e-9, np.array([0.0, 4.0])
    spin, w0 = 3.0 * (0.2 - 0.1) / 0.2, np.array((0.2, 4.0))
    for length in (1.0, 1.01):
        with importing(binary("top", spinning_top())) as own:
            info = own.start()
            x = own.states()
            x[3:7] *= length
            own.place(0.0, x)
            run = own.integrate(times, rtol, info=info)
        e, w = run.x[-1, 3:7], run.x[-1, 10:]
        assert np.linalg.norm(e) == pytest.approx(length, abs=50.0 * rtol)
        turn = spin * times[-1]
        expected = np.array([[cos(turn), sin(turn)], [-sin(turn), cos(turn)]]) @ w0
        np.testing.assert_allclose(w, [3.0, *expected], atol=200.0 * rtol)
        momentum = np.array((0.1, 0.2, 0.2)) * w  # constant in space
        np.testing.assert_allclose(
            rotation(e / length) @ momentum, np.array((0.1, 0.2, 0.2)) * (3.0, 0.2, 4.0), atol=200.0 * rtol
        )


def rotation(e: Any) -> Any:
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = e
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def test_inputs_are_continuous_functions_of_time(binary: Any) -> None:
    """A support that a host moves, and a torque that it gives, against the equation of the pendulum."""
    mass, length = 2.0, 0.8
    inertia = mass * length**2 / 3.0
    given = {
        "x": lambda t: 0.3 * sin(4.0 * t),
        "x.rate": lambda t: 1.2 * cos(4.0 * t),
        "x.acceleration": lambda t: -4.8 * sin(4.0 * t),
        "torque": lambda t: 3.0 * cos(7.0 * t),
    }

    def right(t: float, y: Any) -> list[float]:
        weight = mass * length / 2.0 * (given["x.acceleration"](t) * sin(y[0]) - G * cos(y[0]))
        return [y[1], (weight + given["torque"](t)) / inertia]

    times, rtol = np.linspace(0.0, 2.0, 9), 1e-8
    exact = solve_ivp(right, (0.0, 2.0), (-1.2, 0.0), method="DOP853", rtol=1e-12, atol=1e-12, t_eval=times).y
    with importing(binary("cart", cart()), ["angle", "force"]) as own:
        own.inputs = given
        run = own.integrate(times, rtol, info=own.start())
    np.testing.assert_allclose(run.x, exact.T, atol=100.0 * rtol)
    np.testing.assert_allclose(run.out[:, 0], exact[0], atol=100.0 * rtol)
    for t, (angle, rate), force in zip(times, exact.T, run.out[:, 1], strict=True):  # Newton's law along x
        slope = right(t, (angle, rate))[1]
        along = -length / 2.0 * (slope * sin(angle) + rate**2 * cos(angle))
        expected = 3.0 * given["x.acceleration"](t) + mass * along
        assert force == pytest.approx(expected, abs=1e-4)


def test_signals_that_change_are_time_events(binary: Any) -> None:
    times = np.array([0.0, 0.2, 0.31, 0.6, 1.2])
    with importing(binary("switched", switched())) as own:
        info = own.start()
        events = []
        while info.has_next:
            assert not events or info.next > events[-1]
            events.append(info.next)
            own.place(info.next, own.states())
            info = own.event()
        assert abs(events[0] - 0.3) < 1e-8  # where the torque jumps, next to nothing is integrated
        assert 0.55 < events[1] < 0.7
        assert events[-1] == pytest.approx(0.9, abs=1e-8)
        assert len(events) == 3
    with importing(binary("switched", switched()), ["rate"]) as own:
        run = own.integrate(times, 1e-9, info=own.start())
        more = 1.0 * (0.1 + 0.3)  # the smooth step has half of its height on average
        expected = np.array([0.0, 0.0, 0.01 * 2.0, 0.3 * 2.0, 0.9 * 2.0 + more]) / 0.5
        np.testing.assert_allclose(run.out[:, 0], expected, atol=1e-7)
        assert run.evaluations < 600


@pytest.mark.parametrize(("beyond", "pulses"), [("hold", 1), ("periodic", 2)])
def test_no_importer_passes_a_pulse_of_a_table(binary: Any, beyond: str, pulses: int) -> None:
    """The points of a table are time events: the area of a pulse is 4 N m ms."""
    with importing(binary(f"pulsed {beyond}", pulsed(beyond)), ["rate"]) as own:
        run = own.integrate(np.array([0.0, 15.0]), 1e-4, info=own.start())
    assert run.out[-1, 0] == pytest.approx(pulses * 4e-3 / 0.5, rel=1e-6)


def test_a_sheet_keeps_its_energy(binary: Any) -> None:
    """A large tree: an undamped sheet of 7 x 5 nodes, by its recursions."""
    sheet = Sheet(nx=7, nz=5).build()
    sheet.output("whole_energy", sheet.energy)
    times = np.linspace(0.0, 0.02, 5)
    with importing(binary("sheet", sheet), ["whole_energy"]) as own:
        info = own.start()
        assert own.count == 180
        run = own.integrate(times, 1e-6, RK45, info=info)
    assert np.abs(run.x[-1] - run.x[0]).max() > 1e-3
    assert np.ptp(run.out) < 1e-6 * np.abs(run.out).max() + 1e-9


def test_the_energy_error_is_an_output_where_no_force_does_work(binary: Any) -> None:
    with importing(binary("spatial four-bar", spatial_four_bar()), ["energy_error", "energy_throughput"]) as own:
        run = own.integrate(np.array([0.0, 0.5, 1.0]), 1e-8, info=own.start())
    assert np.abs(run.out[:, 0]).max() < 1e-5
    assert np.isnan(run.out[:, 1]).all()


def test_co_simulation_gives_the_same_motion(binary: Any) -> None:
    mechanism = loops.grashof(0.2).mechanism
    with importing(binary("four-bar", mechanism)) as own:
        run = own.integrate(np.array([0.0, 1.0]), 1e-8, info=own.start())
    fmu = binary("four-bar", mechanism).instantiate()
    assert fmu.set_up(tolerance=1e-8) == OK
    assert fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    assert fmu.step(0.0, 1.0) == OK
    states = [v.valueReference for v in fmu.binary.description.modelVariables if v.name.startswith("state.")]
    status, values = fmu.get("Real", states)
    assert status == OK
    np.testing.assert_allclose(values, run.x[-1], atol=1e-5)
    fmu.free()


# ---- calls -------------------------------------------------------------------------------------------------------


def test_evaluations_depend_on_nothing_but_their_arguments(binary: Any) -> None:
    """In any order, near a singular configuration too; only completed steps change what they are compared with."""
    case = loops.parallelogram(start=10.0)
    times = np.linspace(0.1, 0.25, 12)
    q, v = case.exact(np.concatenate(([0.0], times)))  # type: ignore[misc]
    points = [(t, np.concatenate(both) + 1e-6) for t, *both in zip(times, q[1:], v[1:], strict=True)]
    found = []
    for order in (range(12), range(11, -1, -1), np.random.default_rng(3).permutation(12)):
        with importing(binary("parallelogram 10.0", case.mechanism)) as own:
            own.start()
            own.complete(0.05, own.states())  # a first step that was reported
            slopes = {int(k): own.derivatives(*points[k]) for k in order}
            found.append(np.array([slopes[k] for k in range(12)]))
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])
    assert np.isfinite(found[0]).all()


@pytest.mark.parametrize("solver", ["radau", "ida"])
def test_the_equations_do_not_depend_on_the_solver_of_co_simulation(solver: str, binary: Any, tmp_path: Path) -> None:
    path = export(as_model(spatial_four_bar()), tmp_path / "m.fmu", Settings(solver=solver), native=True)
    found = []
    for own_binary in (binary("spatial four-bar", spatial_four_bar()), Binary(path, tmp_path / "unpacked")):
        with importing(own_binary) as own:
            own.start()
            x = own.states()
            shift = 1e-3 * np.sin(np.arange(len(x)))
            found.append([own.derivatives(0.1 * k, x + k * shift) for k in range(4)])
    np.testing.assert_array_equal(found[0], found[1])
    assert np.isfinite(found[0]).all()


def test_a_state_of_the_fmu_is_restored_to_the_bit(binary: Any) -> None:
    mechanism = spatial_four_bar()
    with importing(binary("spatial four-bar", mechanism)) as own:
        own.integrate(np.array([0.0, 0.3]), 1e-6, info=own.start())
        x = own.states()
        status, state = own.fmu.save()
        assert status == OK
        data = own.fmu.to_bytes(state)
        slope, outputs = own.derivatives(0.3, x), own.read(0.3, x)
        first = own.integrate(np.array([0.3, 0.6]), 1e-6)
        assert own.fmu.restore(state) == OK
        np.testing.assert_array_equal(own.states(), x)
        np.testing.assert_array_equal(own.read(0.3, x), outputs)
        np.testing.assert_array_equal(own.derivatives(0.3, x), slope)
        np.testing.assert_array_equal(own.integrate(np.array([0.3, 0.6]), 1e-6).x, first.x)
        with importing(binary("spatial four-bar", mechanism)) as other:
            other.start()
            status, read = other.fmu.from_bytes(data)
            assert status == OK
            assert other.fmu.restore(read) == OK
            np.testing.assert_array_equal(other.integrate(np.array([0.3, 0.6]), 1e-6).x, first.x)
            assert other.fmu.release(read) == OK
        fmu = own.binary.instantiate()
        assert fmu.restore(state) == ERROR  # of another type
        fmu.free()
        assert own.fmu.release(state) == OK


def test_what_cannot_be_evaluated_is_discarded_and_reported_once(binary: Any) -> None:
    own_binary = binary("four-bar", loops.grashof(0.2).mechanism)
    with importing(own_binary) as own:
        own.start()
        x = own.states()
        good = own.derivatives(0.0, x)
        own_binary.logged.clear()
        for bad in (np.full(len(x), np.nan), np.where(np.arange(len(x)) == 0, inf, x)):
            for _ in range(2):
                assert np.isnan(own.derivatives(0.0, bad)).all()
        assert [(status, text.rsplit(" ", 1)[-1]) for status, text in own_binary.logged] == [
            (DISCARD, "[discarded-evaluation]")
        ]
        np.testing.assert_array_equal(own.derivatives(0.0, x), good)


def test_a_step_to_another_branch_is_discarded_and_warned_of(binary: Any) -> None:
    """The four-bar misses its singular configuration by 1e-4 m; mirrored positions are closed as well."""
    mechanism = loops.parallelogram(1e-4, start=20.0).mechanism
    own_binary = binary("mirrored", mechanism)
    with importing(own_binary) as own:
        own.start()
        own.complete(1e-3, own.states())
        x = own.states()
        crank, turn = x[0], x[1]
        assert abs(turn + crank) < 0.01  # coupler parallel to the ground
        # the other closed position of the same crank: coupler and rocker mirrored at the diagonal
        diagonal = np.arctan2(-np.sin(crank), 3.0 - np.cos(crank))
        along = 2.0 * diagonal
        rocker = np.arctan2(np.sin(crank) + 3.0 * np.sin(along), np.cos(crank) + 3.0 * np.cos(along) - 3.0)
        other = x.copy()
        other[1], other[2] = along - crank, rocker - along
        own_binary.logged.clear()
        assert np.isnan(own.derivatives(0.01, other)).all()
        assert "on another branch" in own_binary.logged[0][1]
        assert own.complete(0.01, other) == WARNING
        assert own_binary.logged[-1][0] == WARNING
        assert own_binary.logged[-1][1].endswith("[left-branch]")
        assert np.isfinite(own.derivatives(0.02, other)).all()  # it is the branch from now on


def test_an_instance_for_few_evaluations_needs_no_completed_steps(binary: Any) -> None:
    """CasADi evaluates derivatives in a second instance, at few points, and reports no steps."""
    own_binary, apart, h = binary("governor", Governor().build()), 20, 1e-4
    times = np.add.outer(np.linspace(0.04, 0.8, apart), (-h, 0.0, h)).ravel()
    with importing(own_binary) as steps, importing(own_binary) as other:
        info = steps.start()
        other.start()
        x = steps.integrate(np.append(0.0, times), 1e-10, info=info).x[1:].reshape(apart, 3, -1)
        own_binary.logged.clear()
        assert np.ptp(x[:, 1, 0]) > 1.0
        for before, here, after, t in zip(*x.swapaxes(0, 1)[:, ::-3], times[1::3][::-3], strict=True):
            slope = other.derivatives(t, here)
            np.testing.assert_allclose(slope, (after - before) / (2.0 * h), atol=1e-3)
        assert not own_binary.logged


def test_calls_in_a_wrong_mode_are_errors_that_change_nothing(binary: Any) -> None:
    own = Importer(binary("cart", cart()))
    fmu, n = own.fmu, own.count
    x, info = (c_double * (n + 1))(), EventInfo()
    event, ends = ctypes.c_int(), ctypes.c_int()
    calls: dict[str, tuple[Any, ...]] = {
        "EnterEventMode": (),
        "NewDiscreteStates": (byref(info),),
        "EnterContinuousTimeMode": (),
        "CompletedIntegratorStep": (ctypes.c_int(1), byref(event), byref(ends)),
        "SetTime": (c_double(0.0),),
        "SetContinuousStates": (x, c_size_t(n)),
        "GetDerivatives": (x, c_size_t(n)),
        "GetEventIndicators": (x, c_size_t(0)),
        "GetContinuousStates": (x, c_size_t(n)),
        "GetNominalsOfContinuousStates": (x, c_size_t(n)),
    }
    readable = {"GetDerivatives", "GetEventIndicators", "GetContinuousStates", "GetNominalsOfContinuousStates"}

    def allowed(*names: str) -> None:
        for name, arguments in calls.items():
            if name not in names:
                assert fmu.call(name, *arguments) == ERROR, name
        assert fmu.step(0.0, 0.1) == ERROR

    allowed()
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == OK
    allowed(*readable)
    assert fmu.call("GetContinuousStates", x, c_size_t(n)) == OK
    assert x[0] == pytest.approx(-1.2)
    assert fmu.call("ExitInitializationMode") == OK
    allowed(*readable, "NewDiscreteStates", "EnterContinuousTimeMode", "SetTime")
    assert fmu.call("NewDiscreteStates", None) == ERROR
    assert fmu.call("NewDiscreteStates", byref(info)) == OK
    assert fmu.call("EnterContinuousTimeMode") == OK
    allowed(*readable, "EnterEventMode", "CompletedIntegratorStep", "SetTime", "SetContinuousStates")
    for count in (0, n - 1, n + 1):
        for name in ("SetContinuousStates", "GetDerivatives", "GetContinuousStates", "GetNominalsOfContinuousStates"):
            assert fmu.call(name, x, c_size_t(count)) == ERROR
    assert fmu.call("GetDerivatives", None, c_size_t(n)) == ERROR
    assert fmu.call("SetContinuousStates", None, c_size_t(n)) == ERROR
    assert fmu.call("CompletedIntegratorStep", ctypes.c_int(1), None, None) == ERROR
    assert fmu.call("GetEventIndicators", x, c_size_t(1)) == ERROR
    assert fmu.call("SetTime", c_double(inf)) == ERROR
    state = own.references["state.position.pendulum"]
    assert fmu.set("Real", [own.references["der(state.position.pendulum)"]], [0.0]) == ERROR
    assert fmu.set("Real", [state], [0.3]) == OK  # as CasADi does
    assert own.states()[0] == 0.3
    assert fmu.call("Terminate") == OK
    assert fmu.set("Real", [state], [0.0]) == ERROR
    assert fmu.get("Real", [state])[1] == [0.3]
    allowed()
    assert fmu.call("Reset") == OK
    allowed()
    own.start()
    assert np.isfinite(own.derivatives(0.0, own.states())).all()
    own.free()
    slave = own.binary.instantiate()
    for name, arguments in calls.items():
        assert slave.call(name, *arguments) == ERROR, name
    slave.free()


def test_parameters_change_at_events_only(exported: Callable[..., Path]) -> None:
    path = exported("swing", SwingPendulum())
    own = Importer(Binary(path, path.parent / "unpacked"))
    tunable = next(v.name for v in own.binary.description.modelVariables if v.variability == "tunable")
    value = next(float(v.start) for v in own.binary.description.modelVariables if v.name == tunable)
    own.start()
    reference_ = [own.references[tunable]]
    assert own.fmu.set("Real", reference_, [value + 0.5]) == ERROR
    assert own.fmu.call("EnterEventMode") == OK
    assert own.fmu.set("Real", reference_, [value + 0.5]) == OK
    info = EventInfo()
    assert own.fmu.call("NewDiscreteStates", byref(info)) == OK
    assert own.fmu.call("EnterContinuousTimeMode") == OK
    assert own.fmu.get("Real", reference_)[1] == [value + 0.5]
    assert np.isfinite(own.derivatives(0.0, own.states())).all()
    own.free()


def test_states_in_co_simulation_are_read_without_an_effect(binary: Any) -> None:
    own_binary = binary("cart", cart())
    slaves = [own_binary.instantiate(), own_binary.instantiate()]
    references = {v.name: v.valueReference for v in own_binary.description.modelVariables}
    states = [k for name, k in references.items() if "state." in name]
    outputs = [references["angle"], references["force"]]
    for fmu in slaves:
        assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    for k in range(20):
        for fmu in slaves:
            assert fmu.set("Real", [references["x"], references["x.rate"]], [0.01 * k * k, 2.0 * k]) == OK
            assert fmu.step(0.01 * k, 0.01) == OK
        status, values = slaves[0].get("Real", states)
        assert status == OK
        both = [fmu.get("Real", outputs)[1] for fmu in slaves]
        assert both[0] == both[1]
        assert values[0] == both[0][0]
        assert values[1] == values[2]  # the velocity, and the derivative of the position
    for fmu in slaves:
        fmu.free()


def test_a_motion_without_its_acceleration_is_constant(tmp_path: Path) -> None:
    """A cart at a constant speed is an inertial frame."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    drive = Input(name="u", unit="m", rate_name="du")
    base = m.body("base", m.ground, Translational(axis="x", drive=drive), mass=1.0)
    m.body("rod", base, Revolute(start=-1.0), **rod(mass=1.0, length=1.0))
    m.output("x", base.position("x"))
    told: list[str] = []
    path = export(as_model(m), tmp_path / "m.fmu", Settings(solver="adams"), native=True, report=told.append)
    (note,) = (line for line in told if "[constant-input]" in line)
    assert note.startswith("in model exchange the inputs 'u', 'du' of joint motions are constant")
    times, rtol = np.array([0.0, 0.7, 1.5]), 1e-8
    exact = solve_ivp(
        lambda _, y: (y[1], -1.5 * G * cos(y[0])), (0.0, 1.5), (-1.0, 0.0), rtol=1e-12, atol=1e-12, t_eval=times
    ).y
    with importing(Binary(path, tmp_path / "unpacked"), ["x"]) as own:
        info = own.start(values={"u": 0.2, "du": 3.0})
        run = own.integrate(times, rtol, info=info)
        np.testing.assert_allclose(run.x, exact.T, atol=100.0 * rtol)
        np.testing.assert_allclose(run.out[:, 0], 0.2 + 3.0 * times, atol=1e-12)
        assert own.fmu.set("Real", [own.references["du"]], [3.0]) == OK
        assert own.fmu.set("Real", [own.references["du"]], [4.0]) == ERROR
        assert "'du' was set to 4, but it is constant in model exchange" in own.binary.logged[-1][1]


def test_a_model_of_many_states_is_for_co_simulation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exchange_states, "MAX_STATES", 5)
    told: list[str] = []
    model = as_model(loops.grashof(0.2).mechanism)
    path = export(model, tmp_path / "m.fmu", Settings(solver="adams"), native=True, report=told.append)
    (note,) = (line for line in told if "[no-model-exchange]" in line)
    assert "it has 6 continuous states" in note
    own = Binary(path, tmp_path / "unpacked")
    assert own.description.modelExchange is None
    assert own.component(0) is None
    assert own.logged == [(ERROR, "model exchange is not supported: this FMU is for co-simulation [fmi-call]")]


# ---- importing tools ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fmi", [2, 3])
def test_cvode_of_fmpy(fmi: int, exported: Callable[..., Path]) -> None:
    """Through exact singular configurations; it reports points between its steps."""
    case, rtol = loops.parallelogram(start=-20.0), 1e-6
    path = exported("parallelogram -20.0", case.mechanism, fmi)
    names = [f"state.position.{body}" for body in ("crank", "coupler", "rocker")]
    options = {"fmi_type": "ModelExchange", "relative_tolerance": rtol, "output": names}
    for interval in (0.01, 0.25):
        rows = simulate_fmu(str(path), stop_time=3.0, output_interval=interval, **options)
        q, _ = case.exact(rows["time"])  # type: ignore[misc]
        found = np.column_stack([rows[name] for name in names])
        assert np.abs(found - q).max() < 1000.0 * rtol
        assert len(rows) == round(3.0 / interval) + 1


@pytest.fixture(scope="module")
def c_importer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program, headers = tmp_path_factory.mktemp("host") / "exchange_host", Path(fmpy.__file__).parent / "c-code"
    compiler = next(filter(None, map(shutil.which, COMPILERS)), "")
    source = Path(__file__).with_name("exchange_host.c")
    flags = ["-std=c2x", "-O1", "-Wall", "-Wextra", "-Werror", f"-I{headers}"]
    subprocess.run([compiler, *flags, "-o", program, source, "-ldl"], check=True)
    return program


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", ["parallelogram", "switched"])
def test_a_c_program_without_python(
    fmi: int, name: str, exported: Callable[..., Path], c_importer: Path, tmp_path: Path
) -> None:
    case = loops.parallelogram(start=-20.0)
    model: Any = case.mechanism if name == "parallelogram" else switched()
    path = exported("parallelogram -20.0" if name == "parallelogram" else name, model, fmi)
    shutil.unpack_archive(path, tmp_path, "zip")
    described = fmpy.read_model_description(str(path))
    (library,) = (tmp_path / "binaries").glob("*/*.so")
    states = [v for v in described.modelVariables if v.name.startswith("state.")]
    resources = (tmp_path / "resources").as_uri() if fmi == 2 else str(tmp_path / "resources")
    token, steps, length = described.guid or described.instantiationToken, 600, 2e-3
    told = [str(fmi), str(library), resources, token, str(tmp_path / "out"), str(steps), str(length), str(len(states))]
    command = [str(c_importer), *told, *(str(v.valueReference) for v in states)]
    done = subprocess.run(command, env={}, cwd="/", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    rows, times = np.fromfile(tmp_path / "out").reshape(-1, len(states)), length * np.arange(steps + 1)
    if name == "parallelogram":
        q, v = case.exact(times)  # type: ignore[misc]
        np.testing.assert_allclose(rows, np.hstack((q, v)), atol=1e-7)
    else:
        rate = 4.0 * np.maximum(0.0, times - 0.3)
        before = times < 0.7
        np.testing.assert_allclose(rows[before, 1], rate[before], atol=1e-7)
        np.testing.assert_allclose(rows[-1, 1], 4.0 * 0.9 + 0.8, atol=1e-5)


MODELS: dict[str, Model] = {"governor": Governor(), "sheet": Sheet(nx=7, nz=5)}


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", MODELS)
def test_descriptions_validate_and_keep_their_value_references(
    fmi: int, name: str, exported: Callable[..., Path]
) -> None:
    path = exported(f"{name} model", MODELS[name], fmi)
    described = fmpy.read_model_description(str(path), validate=True, validate_model_structure=True)
    assert described.modelExchange.needsCompletedIntegratorStep
    assert described.modelExchange.modelIdentifier == described.coSimulation.modelIdentifier
    compiled = MODELS[name].compile()
    assert described.numberOfContinuousStates == compiled.system.nq + compiled.system.n
    assert described.numberOfEventIndicators == 0
    exchanged = [v for v in described.modelVariables if "state." in v.name]
    first = min(v.valueReference for v in exchanged)
    assert first > max(v.valueReference for v in described.modelVariables if v not in exchanged)
    assert sorted(v.valueReference for v in exchanged) == list(range(first, first + len(exchanged)))
    for v in exchanged:
        assert v.causality == "local"
        assert v.name.startswith("der(") == (v.derivative is not None)
        assert v.derivative is None or v.name == f"der({v.derivative.name})"
        assert v.derivative is not None or float(v.nominal) > 0.0
