"""IDA called by its C functions does what it does by way of scikit-sundae."""

from __future__ import annotations

import gc
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fmus.fourbar import FourBar
from fmus.sheet import Sheet
from mbfmu.mechanics import Harmonic, JointForce, JointSpring, Mechanism, Revolute, Translational, rod
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation
from solvers.compiled.kernel import COMPILED
from solvers.steppers.ida import dense, installed_library, sundials, tree
from solvers.steppers.ida.binding import BoundIDA
from solvers.steppers.ida.sundials import DirectIDA

pytestmark = pytest.mark.skipif(not COMPILED, reason="without a compiler there is one way only")

Ways = Callable[[Any, float, float], list[Simulation]]


@pytest.fixture
def both_ways(monkeypatch: pytest.MonkeyPatch) -> Ways:
    """Return what runs a model until a time at a tolerance, first directly, then through scikit-sundae.

    That binding cannot say when a matrix is old, so IDA's own rule serves both.
    """
    monkeypatch.setattr(sundials, "MAX_CJ_CHANGE", 0.25)

    def run(model: Any, tolerance: float, end: float) -> list[Simulation]:
        runs = []
        for serves in (True, False):
            for module in (dense, tree):
                monkeypatch.setattr(module, "is_library_supported", lambda serves=serves: serves)
            simulation = Simulation(model, Settings(solver="ida", tolerance=tolerance))
            stepper: Any = simulation.stepper
            assert isinstance(stepper._ida, DirectIDA if serves else BoundIDA)
            stepper._begin()  # in Python, so that the rule above is that of IDA; compiled kernels have their own
            assert simulation.advance(0.4 * end).ok
            assert simulation.advance(end).ok
            runs.append(simulation)
        return runs

    return run


def pendulum() -> Mechanism:
    """Return two links on a driven hub: no loop, and coordinates that work is done on."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    hub = m.body("hub", m.ground, Revolute(drive=Harmonic(amplitude=0.4, frequency=0.7)), mass=1.0)
    first = m.body("first", hub, Revolute(start=0.3), **rod(mass=1.0, length=0.5))
    m.body("second", first, Revolute(at=(0.5, 0.0, 0.0), start=-0.8), **rod(mass=0.4, length=0.3))
    return m


def test_the_installed_library_serves() -> None:
    assert sundials.is_library_supported()


def test_the_library_is_loaded_without_the_package_which_can_be_imported_later() -> None:
    """The package imports most of SciPy."""
    code = """
import sys
from solvers.steppers.ida.sundials import is_library_supported
assert is_library_supported()
print([name for name in ("sksundae", "scipy.optimize") if name in sys.modules])
import sksundae
"""
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_the_package_is_imported_if_its_files_are_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    from sksundae import _cy_common, _cy_ida

    found = installed_library.configuration()
    assert found == {name: str(value) for name, value in _cy_common.config.items()}
    assert installed_library.extension_path() == _cy_ida.__file__
    monkeypatch.setattr(installed_library, "_folders", list)
    assert installed_library.configuration() == found
    assert installed_library.load_extension(lambda path: path) == _cy_ida.__file__


def test_the_package_is_imported_if_its_libraries_are_found_only_then() -> None:
    calls = list[str]()

    def load(path: str) -> str:
        calls.append(path)
        if len(calls) == 1:
            raise OSError("library not found")
        return path

    assert installed_library.load_extension(load) == calls[0]
    assert len(calls) == 2


@pytest.mark.parametrize(
    ("model", "end", "apart"),
    [(FourBar(), 1.5, 1e-9), (pendulum(), 2.0, 1e-9), (Sheet(nx=9, nz=6), 0.05, 1e-9)],
    ids=["loop", "pendulum", "sheet"],
)
def test_both_ways_take_the_same_steps(both_ways: Ways, model: Any, end: float, apart: float) -> None:
    direct, bound = both_ways(model, 1e-5, end)
    assert direct.statistics.steps == bound.statistics.steps > 10
    assert direct.statistics.rhs_evals == bound.statistics.rhs_evals
    assert direct.stepper.q == pytest.approx(bound.stepper.q, rel=apart, abs=apart)
    assert direct.stepper.v == pytest.approx(bound.stepper.v, rel=100 * apart, abs=100 * apart)
    assert direct.stepper.energy_account == pytest.approx(bound.stepper.energy_account, rel=1e-6, abs=1e-9)


def test_order_and_length_of_the_last_step_are_reported() -> None:
    simulation = Simulation(pendulum(), Settings(solver="ida", tolerance=1e-8))
    simulation.advance(1.0)
    told = simulation.statistics
    assert 3 <= told.order <= 5
    assert 1e-5 < told.step_size < 0.1
    before = told.steps, told.rejected
    simulation.stepper.restart()
    simulation.advance(1.1)
    assert (simulation.statistics.steps, simulation.statistics.rejected) > before, "counts go on over a restart"
    saved = simulation.stepper.save()
    counted = simulation.statistics.rejected
    simulation.advance(2.0)
    simulation.stepper.restore(saved)
    assert simulation.statistics.rejected == counted


def test_a_thousand_of_them_leave_nothing_behind() -> None:
    gc.collect()
    sizes = []
    for _ in range(3):
        for _ in range(300):
            ida = Simulation(pendulum(), Settings(solver="ida")).stepper._ida  # type: ignore[attr-defined]
            ida.begin(0.0, np.zeros(4), np.zeros(4))
            del ida
        gc.collect()
        with open("/proc/self/statm") as file:  # noqa: PTH123
            sizes.append(int(file.read().split()[1]) * 4096)
    assert sizes[2] - sizes[1] < 3e6


@pytest.mark.parametrize("damping", [1e4, 1e5])
def test_a_loaded_stiff_spring_takes_the_steps_of_its_load(damping: float) -> None:
    """Newton's error in the position must not reach the error test by way of the stiff mode's speed."""
    mass, stiffness, load, rate = 2.0, 1e8, 1e6, 3.0
    m = Mechanism()
    body = m.body("body", m.ground, Translational(axis="x"), mass=mass)
    m.force("spring", JointSpring(stiffness=stiffness, damping=damping), body)
    m.force("load", JointForce(f"{load}*sin({rate}*t)"), body)
    simulation = Simulation(m, Settings(solver="ida", tolerance=1e-6), duration=0.5)
    assert simulation.advance(0.5).ok
    counted = simulation.statistics
    assert counted.rejected < 0.1 * counted.steps
    assert counted.steps < 3000  # 100 000 of them before
    forced = load / (stiffness - mass * rate**2 + 1j * damping * rate)
    assert simulation.stepper.q[0] == pytest.approx((forced * np.exp(0.5j * rate)).imag, abs=3e-5 * abs(forced))
