"""Every command and every export of models that lack coordinates, constraints, inputs, outputs or parameters."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from empty_models import DrivenArm, DrivenLoop, Silent, Truss, Welded
from running import Running, needs_linker

from mbfmu.fmi import export
from mbfmu.modeling import Model
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation

FILE = Path(__file__).with_name("empty_models.py")
MODELS = {kind.__name__: kind for kind in (DrivenArm, DrivenLoop, Welded, Silent, Truss)}
FIXED = ("DrivenArm", "DrivenLoop", "Welded")  # no free coordinate

COMMANDS: dict[str, tuple[str, ...]] = {
    "models": (),
    "run": ("--direct", "--solver", "adams"),
    "run by hybrid": ("--direct", "--solver", "hybrid"),
    "run by radau": ("--direct", "--solver", "radau"),
    "run by auto": ("--direct", "--solver", "auto"),
    "check": (),
    "compare": (),
    "equilibrium": (),
    "modes": (),
    "linearize": (),
    "view": (),
    "export": (),
}
REFUSED = {  # messages of every model, or of those without a free coordinate
    "compare": "no output of model",
    "equilibrium": "has no free coordinate",
    "modes": "has no free coordinate",
    "linearize": "has no free coordinate",
}


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("what", COMMANDS)
def test_commands_return_a_result_or_report_what_is_missing(
    name: str, what: str, command: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = command(what.partition(" ")[0], f"{FILE}:{name}", *COMMANDS[what])
    refused = REFUSED.get(what) if name in FIXED or what == "compare" else None
    assert code == (2 if refused else 0), err
    if refused:
        assert refused in err


@needs_linker
@pytest.mark.parametrize("solver", ["adams", "hybrid", "radau"])
@pytest.mark.parametrize("name", MODELS)
def test_machine_code_has_the_numbers_of_python(name: str, solver: str) -> None:
    model: Model = MODELS[name]()
    simulation = Simulation(model, Settings(solver=solver))
    native = Running(Simulation(model, Settings(solver=solver)))
    assert native.call("assemble", 0.0) == 0
    assert native.call("begin", 0.0) == 0
    for t in (0.1, 0.2):
        assert native.call("step", t) == int(simulation.advance(t).code) == 0
        assert native.call("read") == 0
        np.testing.assert_array_equal(native.out[:-2], simulation.outputs()[:-2])


@needs_linker
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", MODELS)
def test_native_fmus_run(name: str, fmi: int, tmp_path: Path) -> None:
    path = export(MODELS[name](), tmp_path / "it.fmu", Settings(solver="adams"), native=True, fmi=fmi)
    assert zipfile.ZipFile(path).testzip() is None
    found = fmpy.simulate_fmu(str(path), stop_time=0.2, output_interval=0.1)
    assert found["time"][-1] == 0.2
    if name == "DrivenArm":  # a rod held at 0.3 rad
        assert found["torque"] == pytest.approx(0.5 * 9.81 * np.cos(0.3), rel=1e-12)
    if name == "DrivenLoop":
        assert found["angle"] == pytest.approx(0.3 * np.sin(0.4 * np.pi * found["time"]), abs=1e-12)
    if name == "Truss":  # an equilateral triangle
        assert found["angle"] == pytest.approx(np.pi / 3.0, abs=1e-9)
