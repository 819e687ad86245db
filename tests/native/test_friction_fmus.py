"""Joint friction in native FMUs: the bits of a simulation, and parameters of mass and size."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest
from fmpy import simulate_fmu

import mbfmu as mb
from mbfmu.fmi.export import export

G = 9.81
needs_compiler = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")


@dataclass(frozen=True, kw_only=True)
class BrakedBlock(mb.Model):
    """A block that slides until friction stops it."""

    mass: float = mb.parameter(2.0, unit="kg", min=0.1, doc="Mass of the block")
    friction: float = mb.parameter(0.5, min=0.01, doc="Coefficient of friction")
    speed: float = mb.parameter(2.0, unit="m/s", doc="Velocity at the start")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        joint = mb.Translational(axis="x", nominal=1.0, rate=self.speed)
        block = m.body("block", m.ground, joint, mass=self.mass)
        weight = mb.Input(name="normal.force", unit="N", start=2.0 * G)
        friction = m.force("friction", mb.JointFriction(coulomb=self.friction, normal_force=weight), block)
        m.output("x", block.coordinate())
        m.output("force", friction.effort())
        return m


@needs_compiler
def test_native_fmu_stops_as_the_simulation_and_for_other_parameters(tmp_path: Path) -> None:
    settings = mb.Settings(solver="radau", tolerance=1e-6)
    path = export(BrakedBlock(), tmp_path / "block.fmu", settings, native=True)
    found = simulate_fmu(str(path), stop_time=1.0, output_interval=0.05, fmi_type="CoSimulation")
    simulation = mb.Simulation(BrakedBlock(), settings)
    for row in found[1:]:
        assert simulation.advance(row["time"]).ok
        assert [row["x"], row["force"]] == simulation.outputs()[:2].tolist()
    values = {"mass": 4.0, "friction": 0.8, "speed": 3.0}
    for kind in ("CoSimulation", "ModelExchange"):
        how = {"fmi_type": kind, "relative_tolerance": 1e-6, "output_interval": 0.05}
        found = simulate_fmu(str(path), stop_time=2.0, start_values=values, **how)
        assert found["x"][-1] == pytest.approx(4.0 * 9.0 / (2.0 * 0.8 * 2.0 * G), abs=1e-4), kind


@dataclass(frozen=True, kw_only=True)
class Drawer(mb.Model):
    """A drawer pulled at a distance from its guide, a top on a ball, whose friction follows reactions; and a puck."""

    offset: float = mb.parameter(0.3, unit="m", doc="Distance of the force from the guide")
    length: float = mb.parameter(0.4, unit="m", min=0.01, doc="Length of the guide")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
        joint = mb.Translational(axis="x", nominal=1.0)
        given = {"mass": 2.0, "com": (0.0, 0.1, 0.0), "inertia": (1.0, 1.0, 1.0)}
        drawer = m.body("drawer", m.ground, joint, **given)
        bearings = mb.Reaction(length=self.length)
        friction = m.force("friction", mb.JointFriction(coulomb=0.3, normal_force=bearings), drawer)
        m.force("pull", mb.PointForce(magnitude=10.0, axis="x", at_a=(0.0, self.offset, 0.0)), drawer)
        top = m.body("top", m.ground, mb.Spherical(rate=(0.0, 0.0, 2.0)), mass=1.0, inertia=(0.1, 0.1, 0.1))
        m.force("weight", mb.PointForce(magnitude=20.0, axis="z"), top)
        m.force("ball", mb.SphericalFriction(coulomb=0.2, normal_force=mb.Reaction(radius=0.05)), top)
        m.output("x", drawer.coordinate())
        m.output("force", friction.effort())
        puck = m.body("puck", m.ground, mb.Planar(rate=(0.6, 0.8, 0.0)), mass=1.0, inertia=(0.1, 0.1, 0.1))
        m.force("sliding", mb.PlanarFriction(coulomb=0.5, radius=0.1, normal_force=mb.Reaction(preload=2.0)), puck)
        m.output("rate", top.angular_velocity("z"))
        m.output("puck", puck.coordinate(0))
        return m


@needs_compiler
def test_native_fmu_of_friction_that_follows_the_reaction(tmp_path: Path) -> None:
    """The bits of the simulation; for other parameters m x'' = F - 2 mu |F c - m e x''| / l, or a jam."""
    settings = mb.Settings(solver="radau", tolerance=1e-6)
    path = export(Drawer(), tmp_path / "drawer.fmu", settings, native=True)
    found = simulate_fmu(str(path), stop_time=1.0, output_interval=0.05, fmi_type="CoSimulation")
    simulation = mb.Simulation(Drawer(), settings)
    for row in found[1:]:
        assert simulation.advance(row["time"]).ok
        assert [row[name] for name in ("x", "force", "rate", "puck")] == simulation.outputs()[:4].tolist()
    for kind in ("CoSimulation", "ModelExchange"):
        how = {"fmi_type": kind, "relative_tolerance": 1e-6, "output_interval": 0.05, "stop_time": 1.0}
        found = simulate_fmu(str(path), start_values={"offset": 0.2, "length": 0.5}, **how)
        k = 2.0 * 0.3 / 0.5
        acceleration = (10.0 - k * 10.0 * 0.2) / (2.0 - k * 2.0 * 0.1)
        assert found["x"][-1] == pytest.approx(0.5 * acceleration, rel=5e-3), kind
        assert found["force"][-1] == pytest.approx(2.0 * acceleration - 10.0, rel=1e-6), kind
        assert found["rate"][10] == pytest.approx(2.0 - 0.5 * 0.2 * 0.05 * 20.0 / 0.1, abs=3e-5), kind
        assert found["puck"][-1] == pytest.approx(0.3, abs=6e-5), kind
        found = simulate_fmu(str(path), start_values={"offset": 0.8}, **how)
        assert abs(found["x"][-1]) < 3e-5, kind


@dataclass(frozen=True, kw_only=True)
class Stack(mb.Model):
    """Blocks that slide on each other until friction stops them, more of them than small models have, and a motor that
    positions the uppermost one.
    """

    friction: float = mb.parameter(2.0, unit="N", min=0.01, doc="Friction between two blocks")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        block = m.ground
        for k in range(62):
            joint = mb.Translational(axis="x", nominal=1.0, rate=0.5 * (-1.0) ** k)
            block = m.body(f"block{k}", block, joint, mass=1.0 + 0.1 * (k % 7))
            law = mb.JointFriction(coulomb=self.friction, viscous=0.1, deflection=1e-3)
            m.force(f"friction{k}", law, block)
        seen = m.lag("seen", block.position("x"), time_constant=0.02)
        control = m.pid("control", 0.2, seen, proportional=50.0, integral=100.0)
        m.dc_motor("motor", block, control, resistance=1.0, inductance=1e-3, torque_constant=0.1, ratio=10.0)
        m.output("x", block.position("x"))
        m.output("energy", m.energy)
        return m


@needs_compiler
def test_native_fmu_of_a_large_tree_with_friction(tmp_path: Path) -> None:
    settings = mb.Settings(solver="ida", tolerance=1e-6)
    path = export(Stack(), tmp_path / "stack.fmu", settings, native=True)
    for friction in (2.0, 3.0):
        start = {"friction": friction}
        found = simulate_fmu(
            str(path), stop_time=0.5, output_interval=0.05, start_values=start, fmi_type="CoSimulation"
        )
        simulation = mb.Simulation(Stack(friction=friction), settings)
        for row in found[1:]:
            assert simulation.advance(row["time"]).ok
            assert [row["x"], row["energy"]] == simulation.outputs()[:2].tolist(), friction


@dataclass(frozen=True, kw_only=True)
class Cylinder(mb.Model):
    """A controlled cylinder with a seal, which moves a mass on a spring."""

    friction: float = mb.parameter(3.0, unit="N", min=0.1, doc="Friction of the seal")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        body = m.body("mass", m.ground, mb.Translational(axis="x", at=(1, 0, 0), nominal=1.0), mass=2.0)
        target = mb.Input(name="target", unit="m", start=0.2)
        uses = {"q": body.coordinate(), "target": target}
        error = m.state("error", "target - q", uses=uses, unit="m.s")
        m.force("cylinder", mb.LineForce(magnitude="150 * (1 + target - x) + 80 * z - 30 * v",
                uses={"z": error, "target": target}), m.ground, body)  # fmt: skip
        m.force("tilt", mb.Torque(magnitude=body.rate()), body)
        m.force("seal", mb.LineFriction(coulomb=self.friction, deflection=1e-4), m.ground, body)
        m.output("x", body.coordinate())
        return m


@needs_compiler
@pytest.mark.campaign
def test_native_fmus_of_a_cylinder_with_a_law_and_a_seal_move_as_the_simulation(tmp_path: Path) -> None:
    settings = mb.Settings(solver="radau", tolerance=1e-6)
    path = export(Cylinder(), tmp_path / "cylinder.fmu", settings, native=True)
    found = simulate_fmu(str(path), stop_time=1.5, output_interval=0.1, fmi_type="CoSimulation")
    simulation = mb.Simulation(Cylinder(), settings)
    for row in found[1:]:
        assert simulation.advance(row["time"]).ok
        assert row["x"] == simulation.outputs()[0]
    assert found["x"][-1] > 0.1
    how = {"fmi_type": "ModelExchange", "relative_tolerance": 1e-6, "output_interval": 0.1}
    exchanged = simulate_fmu(str(path), stop_time=1.5, start_values={"friction": 6.0}, **how)
    expected = mb.simulate(Cylinder(friction=6.0), 1.5, interval=0.1, solver="radau", tolerance=1e-6)
    assert exchanged["x"].tolist() == pytest.approx(expected["x"].tolist(), abs=1e-4)
