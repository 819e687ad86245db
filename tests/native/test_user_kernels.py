"""User-defined elements and functions in native FMUs: against SciPy and closed forms, and what is refused."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from binding import export_for_one_run
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.fmi.export import export
from mbfmu.mechanics import Force, Joint, kernel
from mbfmu.util.errors import UserError

needs_compiler = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")
ADAMS = mb.Settings(solver="adams", tolerance=1e-9)
STOP, INTERVAL = 2.0, 0.01


@kernel
def apply(force: Any, t: float, arrays: Any, state: Any) -> None:
    body = state.bodies[force.body]
    speed = np.sqrt(body.Y[0] ** 2 + body.Y[1] ** 2 + body.Y[2] ** 2)
    for k in range(3):
        body.F[k] -= force.drag * speed * body.Y[k]


@kernel
def power(force: Any, t: float, arrays: Any, state: Any) -> Any:
    Y = state.bodies[force.body].Y
    return -force.drag * (Y[0] ** 2 + Y[1] ** 2 + Y[2] ** 2) ** 1.5


@dataclass(frozen=True, kw_only=True)
class AirDrag(Force):
    """Drag proportional to the square of the velocity of the origin of a body."""

    record = np.dtype([("body", np.int64), ("drag", np.float64)])
    apply, power = apply, power
    drag: float

    def fill(self, record: Any, site: Any) -> None:
        record["body"], record["drag"] = site.bodies[0], self.drag


@kernel
def place(joint: Any, qi: int, state: Any) -> None:
    q, rel = state.q, state.rel[0]
    for i in range(3):
        rel.S[0, i], rel.S[0, 3 + i] = 0.0, 0.0
        for j in range(3):
            rel.R[i, j] = 1.0 if i == j else 0.0
        rel.p[i] = 0.0
    rel.S[0, 0] = joint.ratio
    rel.p[0] = joint.ratio * q[qi]


@dataclass(frozen=True, kw_only=True)
class Geared(Joint):
    """A slider along x whose coordinate is its position divided by a ratio."""

    record = np.dtype([("ratio", np.float64)])
    place = place
    nq, nv = 1, 1
    coordinates, units = ("",), ("m",)
    ratio: float


@dataclass(frozen=True, kw_only=True)
class Slider(mb.Model):
    """A mass on a cubic spring, in air, driven by a force that is a function of time."""

    mass: float = mb.parameter(2.0, unit="kg", min=0.1, doc="Mass")
    drag: float = mb.parameter(0.3, unit="kg/m", min=0.0, doc="Drag coefficient")
    hardness: float = mb.parameter(30.0, unit="1", min=1.0, doc="Captured by the function of the spring")

    def build(self) -> mb.Mechanism:
        m, hardness = mb.Mechanism(), self.hardness
        block = m.body("block", m.ground, mb.Translational(axis="x", start=0.2), mass=self.mass)
        m.force("air", AirDrag(drag=self.drag), block)
        spring = mb.Spring(stiffness=lambda x: hardness * x**3 + 10.0 * x, free=1.0, at_a=(-1.0, 0.0, 0.0))
        m.force("spring", spring, m.ground, block)
        m.force("push", mb.PointForce(magnitude="3 * sin(4 * t)", axis="x"), block)
        m.output("x", block.coordinate(), "Position")
        return m

    def positions(self, times: Any) -> Any:
        """Return the position from SciPy."""

        def slope(t: float, y: Any) -> Any:
            x, v = y
            force = 3.0 * np.sin(4.0 * t) - self.drag * abs(v) * v - (self.hardness * x**3 + 10.0 * x)
            return v, force / self.mass

        return solve_ivp(slope, (0.0, times[-1]), (0.2, 0.0), "DOP853", times, rtol=1e-12, atol=1e-12).y[0]


@dataclass(frozen=True, kw_only=True)
class GearedSlider(mb.Model):
    """A mass on a user-defined joint and a spring, whose frequency is known."""

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        block = m.body("block", m.ground, Geared(ratio=2.0, start=0.1), mass=1.5)
        m.force("spring", mb.Spring(stiffness=60.0, free=1.0, at_a=(-1.0, 0.0, 0.0)), m.ground, block)
        m.output("x", block.position("x"), "Position")
        return m


@dataclass(frozen=True, kw_only=True)
class TableSlider(mb.Model):
    """A mass on two springs whose laws are tables of one stiffness."""

    def build(self) -> mb.Mechanism:
        m, law = mb.Mechanism(), mb.Table([-1.0, 0.0, 1.0], [-30.0, 0.0, 30.0], "linear")
        block = m.body("block", m.ground, mb.Translational(axis="x", start=0.2), mass=1.5)
        m.force("spring", mb.Spring(stiffness=law, free=1.0, at_a=(-1.0, 0.0, 0.0)), m.ground, block)
        m.force("in joint", mb.JointSpring(stiffness=law), block)
        m.output("x", block.coordinate(), "Position")
        return m


@dataclass(frozen=True, kw_only=True)
class Rope(mb.Model):
    """Many links in air, with a law of a spring at the end that is a function."""

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
        on = m.ground
        for k in range(61):
            at = (0.1 if k else 0.0, 0.0, 0.0)
            link = mb.Revolute(at=at, start=0.3 if not k else 0.0)
            on = m.body(f"link{k}", on, link, mass=0.1, com=(0.05, 0.0, 0.0), inertia=(1e-5, 1e-4, 1e-4))
            m.force(f"air{k}", AirDrag(drag=0.1), on)
        spring = mb.Spring(stiffness=lambda x: 20.0 * x + 5.0 * x**3, free=5.0, at_a=(0.0, 2.0, 0.0))
        m.force("spring", spring, m.ground, on)
        m.output("y", on.position("y"), "Position")
        return m


@needs_compiler
@pytest.mark.parametrize("solver", ["ida", "esdirk"])
def test_structured_tangents_call_user_defined_kernels(solver: str, tmp_path: Path) -> None:
    """Bits of a simulation, whose tangent has the derivatives of the same kernels."""
    settings = mb.Settings(solver=solver, tolerance=1e-6)
    path = export_for_one_run(Rope(), tmp_path / "rope.fmu", settings)
    found = simulate_fmu(str(path), stop_time=0.1, output_interval=0.01)
    simulation = mb.Simulation(Rope(), settings)
    for row in found[1:]:
        assert simulation.advance(row["time"]).ok
        assert row["y"] == simulation.outputs()[0]


@pytest.fixture(scope="module")
def slider(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(Slider(), tmp_path_factory.mktemp("user") / "slider.fmu", ADAMS, native=True)


def run(fmu: Path, **values: float) -> Any:
    return simulate_fmu(str(fmu), stop_time=STOP, output_interval=INTERVAL, start_values=values)


@needs_compiler
@pytest.mark.parametrize("values", [{}, {"mass": 0.7, "drag": 2.0}, {"drag": 0.0}])
def test_elements_and_functions_of_the_model_move_as_computed_by_scipy(slider: Path, values: dict[str, float]) -> None:
    assert validate_fmu(str(slider)) == []
    found = run(slider, **values)
    assert found["x"] == pytest.approx(Slider(**values).positions(found["time"]), abs=1e-7)


@needs_compiler
def test_a_value_that_a_function_captures_is_constant(slider: Path) -> None:
    known = {v.name: v for v in read_model_description(str(slider)).modelVariables}
    assert known["mass"].causality == "parameter"
    assert known["drag"].causality == "parameter"
    assert known["hardness"].variability == "constant"
    told: list[str] = []
    export(Slider(), slider.with_name("told.fmu"), ADAMS, native=True, report=told.append)
    assert any("'hardness'" in line and "it changes a user-defined function" in line for line in told)


@needs_compiler
@pytest.mark.parametrize("make", [GearedSlider, TableSlider])
def test_a_joint_of_the_model_and_springs_with_tables(make: type[mb.Model], tmp_path: Path) -> None:
    found = run(export(make(), tmp_path / "g.fmu", ADAMS, native=True, fmi=2))
    assert found["x"] == pytest.approx(0.2 * np.cos(np.sqrt(40.0) * found["time"]), abs=1e-7)


@needs_compiler
def test_the_fmu_needs_no_python(slider: Path, tmp_path: Path) -> None:
    subprocess.run(("unzip", "-q", str(slider), "-d", str(tmp_path)), check=True)
    (library,) = tmp_path.glob("binaries/*/mbfmu_kernels.so")
    needed = subprocess.run(("ldd", str(library)), capture_output=True, text=True, check=True).stdout
    assert {line.split()[0].split("/")[-1].split(".")[0] for line in needed.splitlines()} <= {
        "linux-vdso", "libm", "libc", "ld-linux-x86-64", "ld-linux-aarch64",
    }  # fmt: skip


@needs_compiler
def test_a_missing_library_is_an_error_that_names_it(slider: Path, tmp_path: Path) -> None:
    subprocess.run(("unzip", "-q", str(slider), "-d", str(tmp_path)), check=True)
    next(tmp_path.glob("binaries/*/mbfmu_kernels.so")).unlink()
    told: list[str] = []
    with pytest.raises(Exception, match="instantiate"):
        simulate_fmu(str(tmp_path), stop_time=0.1, logger=lambda *a: told.append(str(a[-1])))
    assert any("mbfmu_kernels" in line and "unzip the FMU again" in line for line in told)


@needs_compiler
def test_a_library_of_another_fmu_is_refused(tmp_path: Path, slider: Path) -> None:
    subprocess.run(("unzip", "-q", str(slider), "-d", str(tmp_path / "own")), check=True)
    other = export(GearedSlider(), tmp_path / "g.fmu", ADAMS, native=True)
    subprocess.run(("unzip", "-q", str(other), "-d", str(tmp_path / "other")), check=True)
    (mine,), (theirs,) = ((tmp_path / n).glob("binaries/*/mbfmu_kernels.so") for n in ("own", "other"))
    whole, told = mine.read_bytes(), list[str]()
    for wrong in (theirs.read_bytes(), whole[: len(whole) // 2]):
        mine.write_bytes(wrong)
        with pytest.raises(Exception, match="instantiate"):
            simulate_fmu(str(tmp_path / "own"), stop_time=0.1, logger=lambda *a: told.append(str(a[-1])))
        assert "the file is damaged, or belongs to another FMU; unzip the FMU again" in told[-1]


@needs_compiler
def test_two_fmus_with_other_kernels_in_one_process(tmp_path: Path, slider: Path) -> None:
    other = export(GearedSlider(), tmp_path / "g.fmu", ADAMS, native=True)
    for _ in range(2):
        assert run(slider)["x"][-1] == pytest.approx(Slider().positions(np.array([0.0, STOP]))[-1], abs=1e-7)
        assert run(other)["x"][-1] == pytest.approx(0.2 * np.cos(np.sqrt(40.0) * STOP), abs=1e-7)


def test_a_model_without_a_file_is_refused(tmp_path: Path) -> None:
    @dataclass(frozen=True, kw_only=True)
    class Local(Slider):
        """A model that no other process can import."""

    with pytest.raises(UserError, match="put its class at the top level of a file"):
        export(Local(), tmp_path / "l.fmu", ADAMS, native=True)
    assert list(tmp_path.iterdir()) == []


WASTEFUL = '''
from dataclasses import dataclass
import numpy as np
import mbfmu as mb
from mbfmu.mechanics import Force, kernel


@kernel
def apply(force, t, arrays, state):
    found = np.empty(3)
    for i in range(3):
        found[i] = 0.0 * t
    state.bodies[force.body].F[0] -= found[1]


@kernel
def potential(force, arrays, state):
    return 0.0


class Wasteful(Force):
    record = np.dtype([("body", np.int64)])
    apply, potential = apply, potential

    def fill(self, record, site):
        record["body"] = site.bodies[0]


@dataclass(frozen=True, kw_only=True)
class Model(mb.Model):
    """A kernel that allocates an array."""

    def build(self):
        m = mb.Mechanism()
        block = m.body("block", m.ground, mb.Translational(axis="x"), mass=1.0)
        m.force("f", Wasteful(), block)
        m.output("x", block.coordinate(), "Position")
        return m
'''


@needs_compiler
def test_a_kernel_that_needs_python_is_refused_by_the_export(tmp_path: Path) -> None:
    (tmp_path / "wasteful.py").write_text(WASTEFUL)
    own = {"MPLBACKEND": "Agg", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = (sys.executable, "-m", "mbfmu", "export", "wasteful.py:Model", "--native", "--solver", "adams")
    done = subprocess.run(command, cwd=tmp_path, env={**os.environ, **own}, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert "kernel 'apply'" in done.stderr
    assert "cannot be compiled" in done.stderr
    assert [path.name for path in tmp_path.glob("*.fmu")] == []
