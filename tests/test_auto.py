"""The solver that ``auto`` takes: the cheapest family for the model as it starts, once, and kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu

import mbfmu as mb
from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.sheet import Sheet
from mbfmu.fmi import Fmu
from mbfmu.modeling.model import as_model
from mbfmu.modeling.parameters import declared
from mbfmu.modeling.scene import load_scene
from mbfmu.session.stiffness import spectrum
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.util.diagnostics import without_details

DOWN = {"crank": -1.5, "coupler": 1.5, "rocker": -1.5}


@dataclass(frozen=True, kw_only=True)
class Sprung(mb.Model):
    """A bob of 1 kg on a damped spring, pulled, next to one on a soft spring."""

    name = "sprung"
    stiffness: float = mb.parameter(10.0, min=0.0, unit="N/m", doc="of the spring", tunable=True)

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        bob = m.body("bob", m.ground, mb.Translational(axis="x", start=1e-3), mass=1.0)
        slow = m.body("slow", m.ground, mb.Translational(axis="y", start=1.0), mass=1.0)
        m.force("spring", mb.JointSpring(stiffness=self.stiffness, damping=0.2 * self.stiffness**0.5), bob)
        m.force("other", mb.JointSpring(stiffness=4.0), slow)
        m.output("x", slow.coordinate())
        return m


def ladder(loops: int) -> mb.Mechanism:
    """Rungs of 2 m on pairs of rods of 1 m, one pair below the other."""
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    on, sides = m.ground, ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    for k in range(loops):
        left, right = (
            m.body(f"{side}{k}", on, mb.Revolute(at=at, start=start), **mb.rod(mass=1.0, length=1.0))
            for side, at, start in zip(("left", "right"), sides, (-1.0, -1.0), strict=True)
        )
        pin = mb.Revolute(at=(1.0, 0.0, 0.0), start=1.0)
        rung = m.body(f"rung{k}", left, pin, mass=1.0, com=(1.0, 0.0, 0.0), inertia=(0.1, 0.1, 0.1))
        m.cut(f"pin{k}", mb.RevoluteCutJoint(at_a=(2.0, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), rung, right)
        on, sides = rung, ((0.0, 0.0, 0.0), (2.0, 0.0, 0.0))
    return m


def chain(count: int) -> mb.Mechanism:
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    on = m.ground
    for k in range(count):
        at = (0.0, 0.0, 0.0) if k == 0 else (1.0, 0.0, 0.0)
        on = m.body(f"link{k}", on, mb.Revolute(at=at, start=0.1), **mb.rod(mass=1.0, length=1.0))
    return m


def rotor(scale: float) -> mb.Mechanism:
    """A heavy hub at 314 rad/s, and a disk on it by a stiff and damped shaft, twisted a little."""
    m = mb.Mechanism()
    hub = m.body("hub", m.ground, mb.Revolute(rate=314.0, fixed=True), mass=1.0, inertia=(scale**2,) * 3)
    disk = m.body("disk", hub, mb.Revolute(start=1e-3, fixed=True), mass=1e-3, inertia=(1e-2 * scale**2,) * 3)
    m.force("shaft", mb.JointSpring(stiffness=1e3 * scale**2, damping=100.0 * scale**2), disk)
    return m


def flap(decay: float, start: float = 0.0) -> mb.Mechanism:
    """A pendulum with a flap on a spring so damped that it creeps back at ``decay``, 1/s."""
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    arm = m.body("arm", m.ground, mb.Revolute(start=0.5), **mb.rod(mass=1.0, length=1.0))
    own = m.body("flap", arm, mb.Revolute(at=(1.0, 0.0, 0.0), start=start), **mb.rod(mass=0.1, length=0.2))
    inertia = 0.1 * 0.2**2 / 3.0
    m.force("hinge", mb.JointSpring(stiffness=inertia * decay**2, damping=2.0 * inertia * decay), own)
    return m


def turning_loop() -> mb.Mechanism:
    """A four-bar whose heavy crank turns at 20 rad/s, nearly constant: its rocker has to be followed."""
    m = mb.Mechanism()
    crank = m.body("crank", m.ground, mb.Revolute(start=1.0, rate=20.0), mass=50.0, inertia=(5.0, 5.0, 5.0))
    coupler = m.body("coupler", crank, mb.Revolute(at=(0.5, 0.0, 0.0), start=-0.5), **mb.rod(mass=1.0, length=2.0))
    rocker = m.body("rocker", m.ground, mb.Revolute(at=(2.0, 0.0, 0.0), start=1.7), **mb.rod(mass=1.0, length=1.5))
    m.cut("pin", mb.RevoluteCutJoint(at_a=(2.0, 0.0, 0.0), at_b=(1.5, 0.0, 0.0)), coupler, rocker)
    return m


def on_a_stop() -> mb.Mechanism:
    """A pendulum with a bob that gravity soon lays against a hard stop, where it stays."""
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    arm = m.body("arm", m.ground, mb.Revolute(start=-2.0), **mb.rod(mass=1.0, length=1.0))
    bob = m.body("bob", arm, mb.Translational(axis="x", at=(1.0, 0.0, 0.0), start=-1e-3), mass=0.2)
    m.force("stop", mb.JointStop(upper=0.0, stiffness=1e6, damping=100.0), bob)
    return m


def at_rest(stiffness: float) -> mb.Mechanism:
    """A pendulum that hangs still, with a bob on a damped spring."""
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    arm = m.body("arm", m.ground, mb.Revolute(start=-np.pi / 2), **mb.rod(mass=1.0, length=1.0))
    bob = m.body("bob", arm, mb.Translational(axis="x", at=(1.0, 0.0, 0.0), start=9.81 / stiffness), mass=1.0)
    m.force("spring", mb.JointSpring(stiffness=stiffness, damping=stiffness**0.5), bob)
    return m


def stiff_coupler(**changed: float) -> FourBar:
    model = load_scene("fourbar/flexible").model
    assert isinstance(model, FourBar)
    return model.with_values({"youngs_modulus": 1e4 * model.youngs_modulus} | changed)


CASES: dict[str, tuple[Callable[[], Any], float, str]] = {
    "four-bar": (FourBar, 1e-6, "adams"),
    "governor": (Governor, 1e-6, "adams"),
    "elastic coupler, as it is": (lambda: load_scene("fourbar/flexible").model, 1e-6, "adams"),
    "elastic coupler, stiff and damped": (stiff_coupler, 1e-6, "radau"),
    "elastic coupler, stiff, too slight to be followed": (lambda: stiff_coupler(coupler_damping=0.0), 1e-6, "radau"),
    "elastic coupler, stiff, followed": (lambda: stiff_coupler(coupler_damping=0.0), 1e-8, "adams"),
    "ladder of large loops": (lambda: ladder(6), 1e-6, "hybrid"),
    "sheet": (lambda: Sheet(nx=7, nz=5), 1e-4, "esdirk"),
    "sheet that stiffens as it bends": (lambda: load_scene("sheet/default").model, 1e-5, "esdirk"),
    "sheet, swings followed": (lambda: Sheet(nx=7, nz=5), 1e-7, "adams"),
    "sheet, damped": (lambda: Sheet(nx=7, nz=5, damping=0.01), 1e-6, "esdirk"),
    "sheet, damped, at a small tolerance": (lambda: Sheet(nx=7, nz=5, damping=0.01), 1e-8, "esdirk"),
    "constant speed beside what is stiff": (lambda: rotor(1.0), 1e-6, "radau"),
    "constant speed, of a millimeter": (lambda: rotor(1e-3), 1e-6, "radau"),
    "constant speed of a crank in a loop": (turning_loop, 1e-6, "adams"),
    "creeps back slowly": (lambda: flap(10.0), 1e-6, "adams"),
    "creeps back at once": (lambda: flap(1e3), 1e-6, "radau"),
    "lifted, and creeps back at once": (lambda: flap(1e4, start=0.3), 1e-6, "radau"),
    "a stop that is met soon": (on_a_stop, 1e-6, "radau"),
    "at rest": (lambda: at_rest(100.0), 1e-6, "adams"),
    "chain": (lambda: chain(110), 1e-6, "adams"),
}


@pytest.mark.parametrize("case", CASES)
def test_auto_takes_the_cheapest_family_and_reports_why(case: str) -> None:
    make, tolerance, solver = CASES[case]
    settings = mb.Settings(solver="auto", tolerance=tolerance)
    simulation = mb.Simulation(make(), settings)
    assert simulation.solver_choice.solver == solver
    assert simulation.diagnostics[0].text.startswith(f"auto selected {solver!r}: ")
    assert mb.Simulation(make(), settings).solver_choice == simulation.solver_choice  # as it would be on any other day


@pytest.mark.parametrize("model", [FourBar(coupler_modes=2), Governor()], ids=["four-bar", "governor"])
def test_differences_find_the_eigenvalues_of_exact_state_matrices(model: mb.Model) -> None:
    found = equilibrium(model, DOWN if isinstance(model, FourBar) else None)
    exact = np.linalg.eigvals(found.state_space.free)
    values = spectrum(found.compiled, 0.0, found.q, found.v).values
    exact, values = (np.sort_complex(np.round(x, 9)) for x in (exact, values))
    np.testing.assert_allclose(values, exact, atol=1e-6 * np.abs(exact).max())


def test_arnoldi_finds_the_fastest_of_many(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = as_model(chain(30)).compile()
    q, v = compiled.assemble()
    whole = spectrum(compiled, 0.0, q, v)
    monkeypatch.setattr("mbfmu.session.stiffness.MAX_DENSE_FREEDOM", 3)
    assert abs(spectrum(compiled, 0.0, q, v).fastest) == pytest.approx(abs(whole.fastest), rel=1e-4)


def test_the_absolute_tolerance_decides_what_is_followed() -> None:
    model = stiff_coupler(coupler_damping=0.0)
    for absolute, solver in ((0.0, "radau"), (1e-9, "adams")):
        settings = mb.Settings(solver="auto", tolerance=1e-6, absolute_tolerance=absolute)
        assert mb.Simulation(model, settings).solver_choice.solver == solver


def test_a_run_is_that_of_the_selected_solver_and_reports_it() -> None:
    auto, named = (mb.simulate(FourBar(), 1.0, solver=solver) for solver in ("auto", "adams"))
    np.testing.assert_array_equal(auto.values, named.values)
    assert auto.diagnostics[0].text.startswith("auto selected 'adams': not stiff")
    assert not without_details(named.diagnostics)


def test_a_saved_state_is_taken_up_by_the_solver_it_was_saved_from() -> None:
    settings = mb.Settings(solver="auto")
    soft = mb.Simulation(Sprung(), settings)
    assert soft.solver_choice.solver == "adams"
    soft.advance(0.5)
    state = soft.save()
    stiff = mb.Simulation(Sprung(stiffness=1e8), settings)
    assert stiff.solver_choice.solver == "radau"
    stiff.restore(state)
    assert stiff.solver_choice == soft.solver_choice
    for simulation in (soft, stiff):
        simulation.advance(2.0)
    np.testing.assert_array_equal(stiff.stepper.q, soft.stepper.q)
    assert stiff.statistics == soft.statistics


def test_no_change_on_the_way_takes_another_solver() -> None:
    simulation = mb.Simulation(Sprung(), mb.Settings(solver="auto"))
    simulation.advance(0.1)
    simulation.retune(Sprung(stiffness=1e8))
    assert simulation.solver_choice.solver == "adams"


def test_old_numbers_of_solvers_keep_their_meaning() -> None:
    (solver,) = (p for p in declared(mb.Settings) if p.name == "solver")
    assert solver.choices == ("ida", "adams", "hybrid", "adams-lu", "radau", "esdirk", "auto")
    assert solver.default == "ida"


def test_an_fmu_accepts_auto_and_logs_the_selection(fourbar_fmu: Path) -> None:
    ends, said = [], []
    for solver in (7, "adams"):
        with Fmu(fourbar_fmu, {"solver": solver}) as fmu:
            fmu.step_to(1.0)
            ends.append(fmu["crank.angle"])
    assert ends[0] == ends[1]
    simulate_fmu(
        str(fourbar_fmu),
        stop_time=0.02,
        start_values={"solver": 7},
        debug_logging=True,
        logger=lambda _env, _name, _status, _category, message: said.append(message.decode()),
    )
    assert any("auto selected 'adams': not stiff" in line for line in said), said


def test_the_command_prints_what_was_used(
    command: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, _ = command("run", "governor", "--solver", "auto", "--stop-time", "0.1", "--direct")
    assert code == 0
    assert "note: auto selected 'adams': not stiff" in out
    assert "default-auto-1e-6" in out
    monkeypatch.setattr("mbfmu.cli.run.MAX_REPEATED_RUN_TIME", -1.0)  # an FMU that is slow is not repeated directly
    _, out, _ = command("run", "governor", "--solver", "auto", "--stop-time", "0.1")
    assert "note: solver 'adams' selected: not stiff" in out
