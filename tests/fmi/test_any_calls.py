"""Any calls in any order, with any values: a status of FMI, a reason, and an instance that continues.

Random calls of the C functions of every model's FMU. Hosts may rely on the following, which is checked after each call:

- no call crashes, and fmi2Fatal is what a failed initialization returns and nothing else;
- a step is fmi2OK or fmi2Discard; a discarded step changes neither outputs nor time, and gives the reason;
- a mistake or a refused value discards the next step, and one that is made right costs no more than that;
- outputs that are read after a good step are numbers; a state goes back to the bit.
"""

from __future__ import annotations

import os
from ctypes import byref, c_double, c_int, c_size_t, c_uint
from math import inf, isnan, nan
from pathlib import Path
from typing import Any, ClassVar

import pytest
from binding import DISCARD, ERROR, FATAL, OK, Binary, Instance
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule, run_state_machine_as_test

from mbfmu.fmi import export
from mbfmu.modeling import models
from mbfmu.modeling.settings import Settings

FACTORS = (1.0, 0.999, 1.001, 0.0, -1.0, 1e300, nan, inf)  # of start values, for the next one
STEPS = (1e-3, 5e-3, 1e-6, 0.0, -1e-3, nan, inf)  # s
SHIFTS = (0.0, 0.0, 0.0, 0.0, 1e-12, 0.1, -0.1, nan)  # s, of the host's clock
WHOLE = (0, 1, 2, 4, 5, -7, 2**31 - 1)
ODD = (-1, 10**6, 2**31 - 1, 2**32 - 1)  # value references


def same(first: list[float], second: list[float]) -> bool:
    """Whether numbers are equal to the bit, or neither is one."""
    return all(a == b or (isnan(a) and isnan(b)) for a, b in zip(first, second, strict=True))


def allowed(*phases: str) -> Any:
    """When FMI allows a call; wild hosts call at any time."""
    return precondition(lambda self: self.wild or self.phase in phases)


wild = precondition(lambda self: self.wild)


class Host(RuleBasedStateMachine):
    """A host that does anything. Subclasses give the FMU."""

    binary: ClassVar[Binary]

    def __init__(self) -> None:
        super().__init__()
        self.fmu: Instance = self.binary.instantiate()
        self.wild = False
        self.phase, self.t = "instantiated", 0.0
        self.mistaken = False  # the next step must be discarded
        self.refused: set[str] = set()  # and every one until these are given right
        self.states: list[tuple[Any, str, float, list[float] | None]] = []
        variables = self.binary.description.modelVariables
        self.references = [v.valueReference for v in variables]
        self.reals = [v for v in variables if v.type == "Real"]
        self.outputs = [v.valueReference for v in self.reals if v.causality == "output"]

    @property
    def message(self) -> str:
        (reference,) = (v.valueReference for v in self.binary.description.modelVariables if v.name == "solver.message")
        status, (text,) = self.fmu.get("String", [reference])
        assert status == OK
        return str(text.decode())

    def well(self):
        """All that was wrong is forgotten."""
        self.mistaken = False
        self.refused.clear()

    @initialize(wild=st.booleans(), begun=st.booleans())
    def choose(self, wild, begun):
        """Half of the hosts do only what they may, and most begin at once: else few would get anywhere."""
        self.wild = wild
        if begun or wild:
            self.enter()
            self.leave()

    # ---- life ---------------------------------------------------------------------------------------------------

    @allowed("instantiated")
    @rule(start=st.sampled_from((0.0, 1.5, nan)), tolerance=st.sampled_from((None, 1e-5, 0.0, 7.0, nan)))
    def set_up(self, start, tolerance):
        if not self.wild:
            start, tolerance = start if start > 0.0 else 0.0, 1e-5
        assert self.fmu.set_up(start, None, tolerance) == OK
        if self.phase != "instantiated":
            self.mistaken = True
        elif isnan(start):
            self.refused.add("experiment")
        else:
            self.t = start
            self.refused.discard("experiment")

    @allowed("instantiated")
    @rule()
    def enter(self):
        assert self.fmu.call("EnterInitializationMode") == OK
        self.mistaken |= self.phase != "instantiated"
        if self.phase == "instantiated":
            self.phase = "initializing"

    @allowed("initializing")
    @rule()
    def leave(self):
        status = self.fmu.call("ExitInitializationMode")
        if self.phase != "initializing":
            assert status == OK
            self.mistaken = True
        elif status == OK:
            self.phase = "running"
        else:
            assert status == FATAL
            assert self.message
            self.phase = "failed"

    @allowed("running")
    @rule(really=st.integers(0, 5))
    def terminate(self, really):
        if really:
            return
        assert self.fmu.call("Terminate") == OK
        self.phase = "terminated"

    @allowed("terminated", "failed")
    @rule(really=st.integers(0, 5))
    def reset(self, really):
        if really and self.phase == "running":
            return
        assert self.fmu.call("Reset") == OK
        self.phase, self.t = "instantiated", 0.0
        self.well()

    # ---- steps --------------------------------------------------------------------------------------------------

    @allowed("running")
    @rule()
    def step(self):
        self.step_from(0.0, 1e-3)

    @wild
    @rule(shift=st.sampled_from(SHIFTS), step=st.sampled_from(STEPS))
    def step_from(self, shift, step):
        before = self.fmu.get("Real", self.outputs)[1]
        status = self.fmu.step(self.t + shift, step)
        possible = self.phase == "running" and 0.0 <= step < inf and abs(shift) <= 1e-9
        if status == OK:
            assert possible
            assert not self.mistaken
            assert not self.refused
            self.t = max(self.t, self.t + shift + step)
            if step > 0.0:
                assert not isnan(self.fmu.get("Real", self.outputs)[1][0])
        else:
            assert status == DISCARD
            assert self.message
            assert same(self.fmu.get("Real", self.outputs)[1], before)
            self.mistaken = False

    # ---- values -------------------------------------------------------------------------------------------------

    @allowed("instantiated", "initializing", "running")
    @rule(data=st.data())
    def set_input(self, data):
        inputs = [v for v in self.reals if v.causality == "input"]
        if inputs:
            variable = data.draw(st.sampled_from(inputs))
            value = data.draw(st.sampled_from((0.5, 1.0, 2.0))) * float(variable.start)
            assert self.fmu.set("Real", [variable.valueReference], [value]) == OK

    @wild
    @rule(data=st.data(), factor=st.sampled_from(FACTORS))
    def set_real(self, data, factor):
        variable = data.draw(st.sampled_from(self.reals))
        value = factor * float(variable.start or 1.0)
        assert self.fmu.set("Real", [variable.valueReference], [value]) == OK

    @wild
    @rule(
        data=st.data(),
        kind=st.sampled_from(("Integer", "Boolean")),
        value=st.sampled_from(WHOLE),
    )
    def set_whole(self, data, kind, value):
        wanted = (kind, "Enumeration") if kind == "Integer" else (kind,)
        named = self.binary.description.modelVariables
        fits = [v for v in named if v.type in wanted and v.name != "start_at_equilibrium"]
        if fits:
            assert self.fmu.set(kind, [data.draw(st.sampled_from(fits)).valueReference], [value]) == OK

    @wild
    @rule(kind=st.sampled_from(("Real", "Integer", "Boolean")), reference=st.sampled_from(ODD))
    def set_what_is_not_there(self, kind, reference):
        assert self.fmu.set(kind, [reference % 2**32], [1]) == OK
        self.mistaken = True

    @wild
    @rule(text=st.sampled_from((b"", b"ida", b"\xc3\xbc")), data=st.data())
    def set_text(self, text, data):
        assert self.fmu.set("String", [data.draw(st.sampled_from(self.references))], [text]) == OK
        self.mistaken = True

    @wild
    @rule(kind=st.sampled_from(("Real", "Integer", "Boolean", "String")), data=st.data())
    def get(self, kind, data):
        wanted = data.draw(st.lists(st.sampled_from(self.references), max_size=5))
        assert self.fmu.get(kind, wanted)[0] == OK
        types = {v.valueReference: v.type for v in self.binary.description.modelVariables}
        fits = {"Integer": ("Integer", "Enumeration")}.get(kind, (kind,))
        self.mistaken |= any(types[reference] not in fits for reference in wanted)

    @wild
    @rule(kind=st.sampled_from(("Real", "Integer", "Boolean")), reference=st.sampled_from(ODD))
    def get_what_is_not_there(self, kind, reference):
        assert self.fmu.get(kind, [reference % 2**32])[0] == OK
        self.mistaken = True

    @wild
    @rule(order=st.integers(-1, 3))
    def derivatives(self, order):
        """The wrapper refuses them; nothing else happens."""
        reference, given, value = c_uint(0), c_int(order), c_double(1.0)
        for name in ("SetRealInputDerivatives", "GetRealOutputDerivatives"):
            assert self.fmu.call(name, byref(reference), c_size_t(1), byref(given), byref(value)) == ERROR

    # ---- states -------------------------------------------------------------------------------------------------

    @rule()
    def save(self):
        read = self.fmu.get("Real", self.outputs)[1]
        status, state = self.fmu.save()
        assert status == OK
        self.states.append((state, self.phase, self.t, read))

    @precondition(lambda self: self.states)
    @rule(data=st.data())
    def go_back(self, data):
        state, phase, t, read = data.draw(st.sampled_from(self.states))
        assert self.fmu.restore(state) == OK
        self.phase, self.t = phase, t
        self.well()
        if phase == "running":
            assert same(self.fmu.get("Real", self.outputs)[1], read)

    @precondition(lambda self: self.states)
    @rule(data=st.data(), harm=st.sampled_from(("none", "none", "short", "empty", "bit")), place=st.integers(0, 10**6))
    def by_bytes(self, data, harm, place):
        state, phase, t, _ = data.draw(st.sampled_from(self.states))
        content = bytearray(self.fmu.to_bytes(state))
        if harm == "short":
            content = content[: place % len(content)]
        elif harm == "empty":
            content = bytearray()
        elif harm == "bit":
            content[place % len(content)] ^= 1 << place % 8
        status, other = self.fmu.from_bytes(bytes(content))
        assert status == OK
        assert self.fmu.restore(other) == OK
        self.fmu.release(other)
        if harm == "none":
            self.phase, self.t = phase, t
            self.well()
        else:
            self.refused.add("state")

    @precondition(lambda self: self.states)
    @rule(data=st.data())
    def forget(self, data):
        place = data.draw(st.integers(0, len(self.states) - 1))
        assert self.fmu.release(self.states.pop(place)[0]) == OK

    def teardown(self):
        for state, *_ in self.states:
            self.fmu.release(state)
        self.fmu.free()


SMALL: dict[str, dict[str, Any]] = {
    "sheet": {"nx": 3, "nz": 3},
    "feeder": {"nx": 5, "nz": 5, "path": "straight", "nips": 1},
}
EXAMPLES = 80 if os.environ.get("CI") else 20


@pytest.mark.parametrize("name", sorted(models()))
def test_any_calls(name: str, tmp_path: Path) -> None:
    model = models()[name](**SMALL.get(name, {}))
    solver = "adams" if model.default_solver == "ida" else model.default_solver  # the other one is there for a reason
    path = export(model, tmp_path / "model.fmu", Settings(solver=solver), native=False)

    class OfThis(Host):
        binary = Binary(path, tmp_path)

    checks = list(HealthCheck)
    few = settings(max_examples=EXAMPLES, stateful_step_count=30, suppress_health_check=checks, deadline=None)
    run_state_machine_as_test(OfThis, settings=few)  # type: ignore[no-untyped-call]
