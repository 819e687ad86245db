"""Blocks in FMUs: co-simulation with and without Python, and model exchange, against SciPy."""

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

needs_compiler = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")
SETTINGS = mb.Settings(solver="adams", tolerance=1e-8)
LIMIT, LENGTH, G = 9.0, 0.5, 9.81


@dataclass(frozen=True, kw_only=True)
class HeldArm(mb.Model):
    """An arm that a motor and a PID controller with limits of the voltage hold."""

    integral: float = mb.parameter(40.0, unit="V/rad/s", min=1.0, doc="Integral gain")
    inductance: float = mb.parameter(0.02, unit="V.s/A", min=1e-3, doc="Inductance of the motor")
    limit: float = mb.parameter(LIMIT, unit="V", min=1.0, doc="Largest voltage")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, -G, 0.0))
        arm = m.body("arm", m.ground, mb.Revolute(start=0.3), **mb.rod(mass=1.0, length=LENGTH))
        target = mb.Input(name="target", unit="rad", start=0.5)
        gains: dict[str, Any] = {"proportional": 30.0, "integral": self.integral, "derivative": 3.0, "rate": arm.rate()}
        measured = m.lag("measured", arm.angle(), time_constant=0.01, start_input=0.3, unit="rad")
        limits: dict[str, Any] = {"lower": -self.limit, "upper": self.limit, "tracking_time": 0.3}
        control = m.pid("control", target, measured, **gains, **limits, unit="V")
        motor = m.dc_motor("motor", arm, control, resistance=1.5, inductance=self.inductance, torque_constant=0.4)
        m.output("arm.angle", arm.angle())
        m.output("voltage", control.value())
        m.output("current", motor.current())
        return m

    def motion(self, times: Any) -> Any:
        """Return angle, voltage and current from SciPy."""

        def voltage(y: Any) -> tuple[float, float]:
            wanted = 30.0 * (0.5 - y[2]) - 3.0 * y[1] + y[3]
            return wanted, float(np.clip(wanted, -self.limit, self.limit))

        def rates(t: float, y: Any) -> list[float]:
            angle, rate, measured, _, current = y
            wanted, given = voltage(y)
            acceleration = (0.4 * current - G * 0.5 * LENGTH * np.cos(angle)) / (LENGTH**2 / 3.0)
            windup = self.integral * (0.5 - measured) + (given - wanted) / 0.3
            return [
                rate, acceleration, (angle - measured) / 0.01, windup,
                (given - 1.5 * current - 0.4 * rate) / self.inductance,
            ]  # fmt: skip

        found = solve_ivp(
            rates, (0.0, times[-1]), (0.3, 0.0, 0.3, 0.0, 0.0), "DOP853", times, rtol=1e-10, atol=1e-11, max_step=1e-3
        ).y
        return found[0], [voltage(y)[1] for y in found.T], found[4]


@pytest.fixture(scope="module")
def native(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(HeldArm(), tmp_path_factory.mktemp("blocks") / "arm.fmu", SETTINGS, native=True)


@needs_compiler
@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("CoSimulation", {}),
        ("CoSimulation", {"integral": 15.0, "inductance": 0.05, "limit": 8.0}),
        ("ModelExchange", {"limit": 10.0}),
    ],
)
def test_native_fmu_with_blocks_moves_as_computed_by_scipy(native: Path, kind: str, values: dict[str, float]) -> None:
    found = simulate_fmu(
        str(native), stop_time=0.6, output_interval=0.02, start_values=values, fmi_type=kind, relative_tolerance=1e-8
    )
    expected = HeldArm(**values).motion(found["time"])
    assert np.max(expected[1]) == pytest.approx(values.get("limit", LIMIT), abs=1e-9)  # it is limited
    for name, exact in zip(("arm.angle", "voltage", "current"), expected, strict=True):
        assert found[name] == pytest.approx(exact, abs=2e-4 if kind == "ModelExchange" else 1e-5), name
    if kind == "CoSimulation":
        simulation = mb.Simulation(HeldArm(**values), SETTINGS)
        for row in found[1:]:
            assert simulation.advance(row["time"]).ok
            assert [row[name] for name in ("arm.angle", "voltage", "current")] == simulation.outputs()[:3].tolist()
