"""Dampers with laws and actuators with limits of the stroke: identities, closed forms, and SciPy."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.fmi.export import export
from mbfmu.mechanics import Damper, JointDamper, LineForce, Mechanism, Table, Translational
from mbfmu.testing import check_element
from mbfmu.util.errors import UserError

SIZES = (1e-3, 1.0, 1e3)  # m
TIGHT: dict[str, Any] = {"solver": "adams", "tolerance": 1e-10}
LAWS: list[Any] = [2.0, Table((-20.0, 0.0, 30.0), (-9.0, 0.0, 40.0), "monotone"), "2 * v + 0.3 * v**3"]
needs_compiler = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")


@pytest.mark.parametrize("kind", [Damper, JointDamper])
@pytest.mark.parametrize("damping", LAWS, ids=["number", "table", "expression"])
def test_dampers_have_the_identities_of_forces(kind: Any, damping: Any) -> None:
    report = check_element(kind(damping=damping))
    assert report.passed, report


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kind", [Damper, JointDamper])
def test_quadratic_drag_slows_a_slider_according_to_the_closed_form(kind: Any, size: float) -> None:
    """m v' = -c v |v|: v = v0 / (1 + c v0 t / m), in both directions."""
    mass, drag = 2.0, 3.0 / size
    for way in (1.0, -1.0):
        m = Mechanism()
        start = 2.0 * way * size
        slider = m.body("slider", m.ground, Translational(axis="x", start=5.0 * size, rate=start), mass=mass)
        law = kind(damping=lambda v: drag * v * abs(v))
        m.force("damper", law, *((slider,) if kind is JointDamper else (m.ground, slider)))
        m.output("rate", slider.rate())
        result = mb.simulate(m, 1.0, **TIGHT)
        np.testing.assert_allclose(result["rate"], start / (1.0 + drag * abs(start) * result.t / mass), rtol=1e-7)


def test_a_table_damps_rebound_and_compression_differently() -> None:
    """The table is linear on both sides of zero: v = v0 exp(-c t / m) with the slope c of the side."""
    law = Table((-1.0, 0.0, 1.0), (-2.0, 0.0, 7.0), "linear")
    for rate, slope in ((0.9, 7.0), (-0.9, 2.0)):
        m = Mechanism()
        slider = m.body("slider", m.ground, Translational(axis="x", start=3.0, rate=rate), mass=2.0)
        handle = m.force("damper", Damper(damping=law), m.ground, slider)
        m.output("rate", slider.rate())
        m.output("force", handle.force("x", on="b"))
        m.output("length_rate", handle.length_rate())
        result = mb.simulate(m, 0.5, **TIGHT)
        np.testing.assert_allclose(result["rate"], rate * np.exp(-slope * result.t / 2.0), rtol=1e-7)
        np.testing.assert_allclose(result["force"], -slope * result["rate"], rtol=1e-9)
        np.testing.assert_allclose(result["length_rate"], result["rate"], rtol=1e-12)


def test_dampers_do_not_move_a_steady_state_and_linear_models_have_their_slope() -> None:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    slider = m.body("slider", m.ground, Translational(axis="y", start=-1.0), mass=2.0)
    m.force("spring", mb.Spring(stiffness=50.0, free=1.0), m.ground, slider)
    m.force("damper", Damper(damping="3 * v + v**3"), m.ground, slider)
    lag = m.state("lag", "y - z", uses={"y": slider.coordinate()}, start=-1.0)
    m.output("lag", lag.value())
    rest = mb.equilibrium(m)
    lowest = -1.0 - 2.0 * 9.81 / 50.0
    np.testing.assert_allclose(np.asarray(rest.q)[0], lowest, rtol=1e-8)
    found = np.sort_complex(np.linalg.eigvals(mb.linearize(m).A))
    swing = np.roots((2.0, 3.0, 50.0))
    np.testing.assert_allclose(found, np.sort_complex(np.r_[swing, -1.0]), rtol=1e-6)


# -- actuator --------------------------------------------------------------------------------------------------------


def test_an_actuator_with_limits_has_the_identities_of_forces() -> None:
    report = check_element(LineForce(magnitude=3.0, lower=0.5, upper=0.9, stop_stiffness=20.0, stop_damping=0.01))
    assert report.passed, report


@dataclass(frozen=True, kw_only=True)
class Cylinder(mb.Model):
    """A cylinder that pushes a mass to the ends of its stroke."""

    size: float = mb.parameter(1.0, unit="m", min=1e-6, doc="Size of the mechanism")
    push: float = mb.parameter(5.0, unit="N", doc="Force of the cylinder at the start, for a size of 1 m")

    mounted: bool = mb.parameter(False, structural=True, doc="Whether a bushing holds the mass")

    def build(self) -> Mechanism:
        size = self.size
        m = Mechanism()
        slider = m.body("slider", m.ground, Translational(axis="x", start=1.2 * size), mass=2.0)
        force = mb.Input(name="force", unit="N", start=self.push * size)
        stops = {"lower": size, "upper": 1.5 * size, "stop_stiffness": 400.0, "stop_damping": 0.2 / size}
        handle = m.force("cylinder", LineForce(magnitude=force, **stops), m.ground, slider)
        mount = np.diag(np.full(6, 2.0)) + np.eye(6, k=1) + np.eye(6, k=-1) if self.mounted else None
        if mount is not None:
            m.force("mount", mb.Bushing(stiffness=mount, preload=np.ones(6)), m.ground, slider)
        m.output("x", slider.coordinate())
        m.output("pushed", handle.force("x", on="b"))
        m.output("energy", m.energy)
        return m


@pytest.mark.parametrize("size", SIZES)
def test_an_actuator_stops_at_the_ends_of_its_stroke_as_computed_by_scipy(size: float) -> None:
    result = mb.simulate(Cylinder(size=size), 2.0, interval=0.05, **TIGHT)
    assert not result.failure
    assert not result.warning

    def law(_: float, y: Any) -> list[float]:
        depth = max(y[0] - 1.5, 0.0)
        return [y[1], (5.0 - 400.0 * depth * max(1.0 + 0.2 * y[1], 0.0)) / 2.0]

    exact = solve_ivp(law, (0.0, 2.0), [1.2, 0.0], "DOP853", result.t, rtol=1e-11, atol=1e-12, max_step=2e-3).y
    assert exact[0].max() > 1.505
    np.testing.assert_allclose(result["x"] / size, exact[0], atol=2e-6)


def test_the_stroke_ends_where_the_stop_holds_the_force() -> None:
    """At rest the stop is pressed in by force over stiffness, at both ends."""
    for force, place in ((5.0, 1.5 + 5.0 / 400.0), (-5.0, 1.0 - 5.0 / 400.0)):
        rest = mb.equilibrium(Cylinder(push=force))
        np.testing.assert_allclose(np.asarray(rest.q)[0], place, rtol=1e-8)


@needs_compiler
def test_a_native_fmu_of_an_actuator_and_a_coupled_bushing_has_the_bits_of_the_simulation(tmp_path: Path) -> None:
    settings = mb.Settings(solver="radau", tolerance=1e-6)
    path = export(Cylinder(mounted=True), tmp_path / "cylinder.fmu", settings, native=True)
    found = simulate_fmu(str(path), stop_time=0.5, output_interval=0.1, fmi_type="CoSimulation")
    simulation = mb.Simulation(Cylinder(mounted=True), settings)
    for row in found[1:]:
        assert simulation.advance(row["time"]).ok
        assert [row["x"], row["pushed"]] == simulation.outputs()[:2].tolist()


@pytest.mark.parametrize(
    ("force", "message"),
    [
        (LineForce(magnitude=1.0, stop_stiffness=3.0), "without a limit; give it lower or upper"),
        (LineForce(magnitude=1.0, upper=2.0), "stop_stiffness of force 'f' is 0.0"),
        (LineForce(magnitude=1.0, lower=2.0, upper=1.0, stop_stiffness=1.0), "lower of force 'f' is 2.0, upper 1.0"),
        (LineForce(magnitude=1.0, lower=-2.0, stop_stiffness=1.0), "lower of force 'f' is -2.0"),
        (Damper(damping=-1.0), "damping of force 'f' is -1.0"),
        (Damper(damping=(1.0, 2.0)), "damping of force 'f' is"),
    ],
)
def test_what_is_no_actuator_or_damper_is_refused(force: Any, message: str) -> None:
    m = Mechanism()
    body = m.body("b", m.ground, Translational(axis="x", start=1.0), mass=1.0)
    with pytest.raises(UserError, match=message):
        m.force("f", force, m.ground, body)
