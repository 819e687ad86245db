"""What native FMUs log: what was requested and nothing else, in texts that fit the call."""

from __future__ import annotations

import ctypes
import re
import zipfile
from collections.abc import Iterator
from ctypes import byref, c_bool, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint, c_void_p
from pathlib import Path
from typing import Any

import pytest
from binding import DISCARD, ERROR, OK, WARNING, Binary
from fmpy import read_model_description
from running import needs_linker

from fmus.fourbar import FourBar
from mbfmu.fmi import export
from mbfmu.session.simulation import Settings

pytestmark = needs_linker

MISLEADING = re.compile("is not allowed in the present state|may be called again|not a variable of this FMU")
LOG = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p)


def references(description: Any) -> dict[str, int]:
    return {v.name: v.valueReference for v in description.modelVariables}


# ---- FMI 2.0 -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lossy(tmp_path_factory: pytest.TempPathFactory) -> Binary:
    """One that loses its balance on the way, which is a warning."""
    folder = tmp_path_factory.mktemp("fmu")
    settings = Settings(solver="adams-lu", tolerance=1e-2)
    return Binary(export(FourBar(), folder / "model.fmu", settings, native=True), folder)


def run(binary: Binary, categories: tuple[bytes, ...] | None, *, logging: bool = True) -> set[int]:
    """The statuses that are logged of a run with a mistake and a warning; ``categories`` turn the log on."""
    binary.logged.clear()
    fmu = binary.instantiate(logging=logging)
    if categories is not None:
        names = (c_char_p * len(categories))(*categories)
        assert fmu.call("SetDebugLogging", c_int(1), c_size_t(len(categories)), names) == OK
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    assert fmu.get("Real", [9999])[0] == ERROR
    for k in range(20):
        assert fmu.step(0.1 * k, 0.1) == OK
    fmu.free()
    return {status for status, _ in binary.logged}


def test_a_host_gets_the_messages_that_it_asks_for(lossy: Binary) -> None:
    assert run(lossy, None, logging=False) == set()
    assert run(lossy, None) == {WARNING, ERROR}
    assert run(lossy, (), logging=False) == {WARNING, ERROR}
    assert run(lossy, (b"logAll",), logging=False) == {WARNING, ERROR}
    assert run(lossy, (b"logStatusWarning",), logging=False) == {WARNING}
    assert run(lossy, (b"logStatusError",)) == {ERROR}


def test_a_failed_step_is_logged_as_discarded(lossy: Binary) -> None:
    for category, wanted in ((b"logStatusDiscard", [DISCARD]), (b"logStatusError", []), (b"logAll", [DISCARD])):
        fmu = lossy.instantiate(logging=False)
        lossy.logged.clear()
        assert fmu.call("SetDebugLogging", c_int(1), c_size_t(1), (c_char_p * 1)(category)) == OK
        assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
        assert fmu.step(1.0, 0.1) == DISCARD  # the FMU is at t = 0
        assert [status for status, _ in lossy.logged if status != WARNING] == wanted
        fmu.free()


def test_messages_can_be_turned_off_again(lossy: Binary) -> None:
    fmu = lossy.instantiate()
    lossy.logged.clear()
    warnings = (c_char_p * 1)(b"logStatusWarning")
    assert fmu.call("SetDebugLogging", c_int(0), c_size_t(1), warnings) == OK
    assert fmu.get("Real", [9999])[0] == ERROR
    assert len(lossy.logged) == 1
    assert fmu.call("SetDebugLogging", c_int(0), c_size_t(0), None) == OK
    assert fmu.get("Real", [9999])[0] == ERROR
    assert len(lossy.logged) == 1
    assert fmu.call("SetDebugLogging", c_int(1), c_size_t(1), (c_char_p * 1)(b"logEvents")) == ERROR
    fmu.free()


def test_why_there_is_no_instance_is_logged_in_any_case(lossy: Binary) -> None:
    lossy.logged.clear()
    assert lossy.component(7, logging=False) is None
    text = "the type of the FMU is 7; allowed: 0 (model exchange) or 1 (co-simulation) [fmi-call]"
    assert lossy.logged == [(ERROR, text)]


def test_what_is_never_offered_is_called_so(lossy: Binary) -> None:
    fmu = lossy.instantiate()
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    value, known = c_double(0.0), c_size_t(1)
    calls: dict[str, tuple[Any, ...]] = {
        "CancelStep": (), "EnterEventMode": (), "EnterContinuousTimeMode": (), "NewDiscreteStates": (None,),
        "SetTime": (value,), "GetDerivatives": (byref(value), known), "GetContinuousStates": (byref(value), known),
    }  # fmt: skip
    for name, arguments in calls.items():
        assert fmu.call(name, *arguments) == ERROR
        said = lossy.logged[-1][1]
        assert said.startswith(f"fmi2{name} is not supported: this FMU is for co-simulation")
    assert fmu.set("String", [references(lossy.description)["solver.message"]], [b"x"]) == ERROR
    assert "no string variable that can be set" in lossy.logged[-1][1]
    fmu.free()


def test_what_to_do_after_too_many_steps_can_be_done_in_a_host(lossy: Binary) -> None:
    fmu = lossy.instantiate()
    assert fmu.set("Integer", [references(lossy.description)["max_steps"]], [1]) == OK
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    fmu.step(0.0, 1.0)
    said = lossy.logged[-1][1]
    assert "max_steps" in said
    assert not MISLEADING.search(said)
    fmu.free()


# ---- FMI 3.0 -----------------------------------------------------------------------------------------------------


class Third:
    """The library of an FMU of FMI 3.0 and what it logs."""

    def __init__(self, path: Path, folder: Path) -> None:
        zipfile.ZipFile(path).extractall(folder)
        self.description = read_model_description(str(path))
        (binary,) = (folder / "binaries").glob("*/*.so")
        self.functions, self.resources = ctypes.CDLL(str(binary)), str(folder / "resources").encode()
        self.logged: list[str] = []
        self.log = LOG(lambda _e, _s, _c, text: self.logged.append(text.decode()))

    def instantiate(self, *, logging: bool = True) -> Any:
        function = self.functions.fmi3InstantiateCoSimulation
        function.restype = c_void_p
        token = self.description.instantiationToken.encode()
        flags = c_bool(False), c_bool(logging), c_bool(False), c_bool(False)
        return c_void_p(function(b"one", token, self.resources, *flags, None, c_size_t(0), None, self.log, None))

    def call(self, instance: Any, name: str, *arguments: Any) -> int:
        return int(self.functions[f"fmi3{name}"](instance, *arguments))


@pytest.fixture(scope="module")
def third(tmp_path_factory: pytest.TempPathFactory) -> Third:
    folder = tmp_path_factory.mktemp("fmu")
    return Third(export(FourBar(), folder / "model.fmu", Settings(solver="adams"), native=True, fmi=3), folder)


@pytest.fixture
def instance(third: Third) -> Iterator[Any]:
    third.logged.clear()
    made = third.instantiate()
    assert made
    begin = c_bool(False), c_double(0.0), c_double(0.0), c_bool(False), c_double(0.0)
    assert third.call(made, "EnterInitializationMode", *begin) == OK
    assert third.call(made, "ExitInitializationMode") == OK
    yield made
    third.call(made, "FreeInstance")


def test_the_log_of_fmi_3_is_off_where_it_was_not_asked_for(third: Third) -> None:
    third.logged.clear()
    one = third.instantiate(logging=False)
    assert third.call(one, "EnterEventMode") == ERROR
    assert not third.logged
    assert third.call(one, "SetDebugLogging", c_bool(True), c_size_t(0), None) == OK
    assert third.call(one, "EnterEventMode") == ERROR
    assert third.logged == [
        "fmi3EnterEventMode is not supported: this FMU is for co-simulation; its capabilities are in "
        "modelDescription.xml [fmi-call]"
    ]
    third.call(one, "FreeInstance")


def test_time_is_the_independent_variable_and_not_a_missing_one(third: Third, instance: Any) -> None:
    (time,) = (c_uint(v.valueReference) for v in third.description.modelVariables if v.name == "time")
    real, whole, truth, text, n = c_double(3.0), c_int64(3), c_bool(True), c_char_p(), c_size_t(1)
    assert third.call(instance, "GetFloat64", byref(time), n, byref(real), n) == OK
    assert real.value == 0.0
    assert third.call(instance, "SetFloat64", byref(time), n, byref(real), n) == ERROR
    assert third.logged[-1] == (
        "'time' was set, but it is the independent variable and determined by the steps [fmi-call]"
    )
    for name, value in (("GetInt64", whole), ("GetBoolean", truth), ("GetString", text)):
        assert third.call(instance, name, byref(time), n, byref(value), n) == ERROR
        assert third.logged[-1] == "'time' is of type Float64, but it was accessed as another type [fmi-call]"


def test_a_wrong_number_of_values_is_called_so(third: Third, instance: Any) -> None:
    values = (c_double * 3)()
    assert third.call(instance, "GetFloat64", byref(c_uint(0)), c_size_t(1), values, c_size_t(3)) == ERROR
    assert third.logged[-1].startswith("the number of values is not that of the value references")


def test_every_function_that_is_not_supported_returns_an_error(third: Third, instance: Any) -> None:
    """Called with nothing but zeros, in a phase where all calls of co-simulation may come."""
    import fmpy

    text = (Path(fmpy.__file__).parent / "c-code" / "fmi3Functions.h").read_text()
    names = set(re.findall(r"FMI3_Export\s+\w+\s+fmi3(\w+);", text))
    silent = {name for name in names if re.match("(Instantiate|Free|GetVersion)", name)}
    offered = {
        "SetDebugLogging", "EnterInitializationMode", "ExitInitializationMode", "Terminate", "Reset", "DoStep",
        *(f"{way}{kind}" for way in ("Get", "Set") for kind in ("Float64", "Int64", "Boolean")), "GetString",
        "GetDirectionalDerivative", "GetAdjointDerivative", "GetOutputDerivatives",
        "GetFMUState", "SetFMUState", "SerializedFMUStateSize", "SerializeFMUState", "DeserializeFMUState",
    }  # fmt: skip
    rest = names - silent - offered
    assert len(rest) > 40
    for name in rest:
        assert third.call(instance, name, *(c_void_p(0) for _ in range(9))) == ERROR
        assert third.logged[-1].startswith(f"fmi3{name} is not supported: this FMU is for co-simulation")
        assert not MISLEADING.search(third.logged[-1])


def test_another_kind_of_fmu_is_refused_with_a_message(third: Third) -> None:
    third.logged.clear()
    function = third.functions["fmi3InstantiateScheduledExecution"]
    function.restype = c_void_p
    given = b"one", third.description.instantiationToken.encode(), third.resources, c_bool(False), c_bool(False)
    assert function(*given, None, third.log, None, None, None) is None
    text = "scheduled execution is not supported: this FMU is for co-simulation and model exchange [fmi-call]"
    assert third.logged[-1] == text
