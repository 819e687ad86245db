"""Hooks by which a type of load describes itself, here user-defined types: the core contains no list of types."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism, Load, LoadGroup, kernel, limit_ratio, part_value, scratch_record
from mbfmu.mechanics.kind import ElementType
from mbfmu.util.errors import UserError

ANCHORAGE = np.dtype([("y", np.float64), ("pull", np.float64)])
CALLS = np.dtype([("count", np.float64), ("total", np.float64, (3,))])
ENTRY = np.dtype([("x", np.float64), ("limit", np.int64)])


class Law(ElementType):
    """Role of a user: a force law, which loads are made of."""

    kernels: ClassVar = {"pull": "entry -> number", "stored": "entry -> number"}
    records: ClassVar = {"entry": ENTRY}
    pull: ClassVar[Any]
    stored: ClassVar[Any] = None


@kernel
def cubic_pull(law: Any, entry: Any) -> Any:
    return law.stiffness * entry.x * entry.x * entry.x


@kernel
def cubic_stored(law: Any, entry: Any) -> Any:
    return 0.25 * law.stiffness * entry.x * entry.x * entry.x * entry.x


@dataclass(frozen=True, kw_only=True)
class Cubic(Law):
    record = np.dtype([("stiffness", np.float64)])
    pull = cubic_pull
    stored = cubic_stored
    stiffness: float

    def fill(self, record: Any, site: Any) -> None:
        record["stiffness"] = self.stiffness


@kernel
def apply(load: Any, t: float, arrays: Any, state: Any) -> None:
    entry, calls = scratch_record(load.entry, ENTRY, state), scratch_record(load.calls, CALLS, state)
    entry.x = state.bodies[load.body].r[1]
    calls.count += 1.0
    state.bodies[load.body].F[1] -= part_value(load.law, 0, arrays, state, entry)


@kernel
def potential(load: Any, arrays: Any, state: Any) -> Any:
    entry = scratch_record(load.entry, ENTRY, state)
    entry.x = state.bodies[load.body].r[1]
    return part_value(load.law, 1, arrays, state, entry)


@kernel
def monitor(load: Any, arrays: Any, state: Any) -> float:
    return limit_ratio(abs(state.bodies[load.body].r[1]), 0.5, 0.8)


@dataclass(frozen=True, kw_only=True)
class Anchor(Load):
    """Pulls a body to the height zero by a law, with a spring that comes with it."""

    record = np.dtype([("body", np.int64), ("law", np.int64), ("entry", np.int64), ("calls", np.int64)])
    apply = apply
    potential = potential
    monitor = monitor
    n_bodies = 1
    title = "an anchor"
    nonsmooth_reason = "anchors jerk"
    stiffness_reason = "anchors are stiff"
    law: Law
    weight: float = 0.0

    @property
    def slip_scale(self) -> float:
        return 0.02

    def companions(self) -> tuple[Load, ...]:
        return (Weight(force=self.weight),) if self.weight else ()

    def fill(self, record: Any, site: Any) -> None:
        (record["body"],), record["law"] = site.bodies, site.part(self.law)
        record["entry"], record["calls"] = site.scratch(ENTRY), site.scratch(CALLS)

    @classmethod
    def check_positions(cls, group: LoadGroup) -> None:
        if any(group.bodies["r"][acting.bodies[0].index][0] > 3.0 for acting in group.acting):
            raise UserError("an anchor is too far out")

    @classmethod
    def check_start(cls, group: LoadGroup) -> list[str]:
        assert len(group.records) == len(group.acting) == len(group.numbers)
        return [f"{len(group.acting)} anchors, g = {group.gravity:g}"]


@kernel
def weigh(load: Any, t: float, arrays: Any, state: Any) -> None:
    state.bodies[load.body].F[1] -= load.force


@kernel
def lift(load: Any, arrays: Any, state: Any) -> Any:
    return load.force * state.bodies[load.body].r[1]


@dataclass(frozen=True, kw_only=True)
class Weight(Load):
    record = np.dtype([("body", np.int64), ("force", np.float64)])
    apply = weigh
    potential = lift
    force: float

    def fill(self, record: Any, site: Any) -> None:
        (record["body"],), record["force"] = site.bodies, self.force


def bob(height: float, *, weight: float = 0.0, x: float = 0.0, gravity: float = 0.0) -> mb.Mechanism:
    """A mass of 2 kg that slides along y and is anchored by 50 N/m^3."""
    m = mb.Mechanism(gravity=(0.0, -gravity, 0.0))
    body = m.body("bob", m.ground, mb.Translational(axis="y", at=(x, 0.0, 0.0), start=height, fixed=True), mass=2.0)
    m.element(Anchor(law=Cubic(stiffness=50.0), weight=weight), body)
    m.output("y", body.coordinate())
    return m


def test_a_part_and_scratch_memory_give_the_law_of_the_user() -> None:
    """Energy of the bob: 50 y^4 / 4 + m v^2 / 2 is what it is at the start."""
    compiled = CompiledMechanism(bob(0.3))
    q, v = np.array([0.2]), np.array([0.7])
    assert compiled.energy(0.0, q, v) == pytest.approx(0.25 * 50.0 * 0.2**4 + 0.5 * 2.0 * 0.7**2, rel=1e-14)
    assert compiled.inverse_dynamics(0.0, q, v, np.zeros(1))[0] == pytest.approx(50.0 * 0.2**3, rel=1e-14)


def test_derivatives_come_from_complex_scratch_memory() -> None:
    """At rest under the weight y = -(5 / 50)^(1/3), and the tangent stiffness is 150 y^2."""
    (shape,) = mb.modes(bob(-0.3, weight=5.0))
    assert shape.mode.frequency == pytest.approx(np.sqrt(150.0 * 0.1 ** (2.0 / 3.0) / 2.0), rel=1e-9)  # rad/s


def test_scratch_memory_is_kept_for_each_instance() -> None:
    compiled = CompiledMechanism(bob(0.3))
    (record,) = compiled.records(Anchor)
    scratch, places = compiled.data.state.scratch, (int(record["entry"]), int(record["calls"]))
    entry, calls = (scratch[at : at + d.itemsize].view(d) for at, d in zip(places, (ENTRY, CALLS), strict=True))
    assert places[0] != places[1]
    for _ in range(3):
        compiled.inverse_dynamics(0.0, np.array([0.25]), np.zeros(1), np.zeros(1))
    assert (calls["count"][0], entry["x"][0]) == (3.0, 0.25)


def test_scratch_memory_has_names_that_interpreted_kernels_can_read() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Summed(Weight):
        force: float = 1.0

        def fill(self, record: Any, site: Any) -> None:
            site.scratch(np.dtype([("sum", np.float64)]))

    m = mb.Mechanism()
    m.load("sum", Summed(), m.body("bob", m.ground, mb.Translational(), mass=1.0))
    with pytest.raises(UserError, match=r"scratch memory of load 'sum' has a field 'sum'; NumPy's records have that"):
        CompiledMechanism(m)


WIDE = np.dtype([("x", np.float64, (5000,))])
NARROW = np.dtype([("x", np.float64)])


@kernel
def spill(load: Any, t: float, arrays: Any, state: Any) -> None:
    work = scratch_record(load.scratch, WIDE, state)
    for k in range(5000):
        work.x[k] = 1.0
    state.bodies[load.body].F[1] -= work.x[4999]


@dataclass(frozen=True, kw_only=True)
class Spilling(Load):
    """Writes 40 kB of scratch memory, whatever it has requested."""

    record = np.dtype([("body", np.int64), ("scratch", np.int64)])
    apply = spill
    asked: Any = WIDE

    def fill(self, record: Any, site: Any) -> None:
        (record["body"],) = site.bodies
        if self.asked is not None:
            record["scratch"] = site.scratch(self.asked)


def test_scratch_memory_that_was_asked_for_is_used() -> None:
    assert mb.equilibrium(hung(Spilling())).outputs["y"] == pytest.approx(-0.01, rel=1e-9)


@pytest.mark.parametrize("asked", [None, NARROW])
def test_scratch_memory_that_was_not_asked_for_is_not_written(asked: Any) -> None:
    with pytest.raises(
        UserError, match=r"load 'weight': kernel 'spill' .* writes scratch memory that its fill has not"
    ):
        CompiledMechanism(hung(Spilling(asked=asked)))


@pytest.mark.parametrize("asked", [np.float64, 3.0, [("x", float)], np.dtype(float)])
def test_scratch_memory_is_a_dtype_of_fields(asked: Any) -> None:
    with pytest.raises(
        UserError, match=r"scratch memory of load 'weight' is .*; allowed: a NumPy dtype of named fields"
    ):
        CompiledMechanism(hung(Spilling(asked=asked)))


def test_what_comes_with_an_element_acts_on_its_bodies() -> None:
    """50 y^3 = -5: the weight that comes with the anchor stretches it."""
    state = mb.equilibrium(bob(-0.3, weight=5.0))
    assert state.outputs["y"] == pytest.approx(-np.cbrt(5.0 / 50.0), rel=1e-9)
    assert [acting.what for acting in bob(0.3, weight=5.0).loads()] == ["an anchor", "weight on an anchor"]


@dataclass(frozen=True, kw_only=True)
class Pair(Weight):
    """A weight that comes with another one, which comes with a third."""

    then: tuple[Load, ...] = ()

    def companions(self) -> tuple[Load, ...]:
        return self.then


def hung(load: Load) -> mb.Mechanism:
    """A mass on a spring of 100 N/m that is loaded."""
    m = mb.Mechanism()
    body = m.body("bob", m.ground, mb.Translational(axis="y"), mass=1.0)
    m.force("spring", mb.JointSpring(stiffness=100.0), body)
    m.load("weight", load, body)
    m.output("y", body.coordinate())
    return m


def test_what_comes_with_a_named_load_and_with_that_acts_too() -> None:
    chain = Pair(force=1.0, then=(Pair(force=2.0, then=(Weight(force=4.0),)),))
    assert mb.equilibrium(hung(chain)).outputs["y"] == pytest.approx(-0.07, rel=1e-9)


@pytest.mark.parametrize("then", [None, 3.0, (mb.Revolute(),)])
def test_companions_are_loads(then: Any) -> None:
    with pytest.raises(UserError, match="companion of load 'weight'"):
        CompiledMechanism(hung(Pair(force=1.0, then=then)))


def test_a_load_is_not_a_companion_of_itself() -> None:
    endless = Pair(force=1.0)
    object.__setattr__(endless, "then", (endless,))
    with pytest.raises(UserError, match="cannot be a companion of itself"):
        CompiledMechanism(hung(endless))


@kernel
def no_number(load: Any, arrays: Any, state: Any) -> float:
    return np.nan


@dataclass(frozen=True, kw_only=True)
class Mute(Weight):
    """Its limit is never a number; hooks return what they should not."""

    monitor = no_number
    start: Any = ()

    @classmethod
    def describe_limit(cls, group: LoadGroup, ratio: float, when: str = "") -> Any:
        return 1.0 / 0.0

    @classmethod
    def check_start(cls, group: LoadGroup) -> Any:
        return group.acting[0].load.start  # type: ignore[attr-defined]


def test_a_limit_that_is_no_number_ends_the_run_and_a_broken_text_is_named() -> None:
    result = mb.simulate(hung(Mute(force=1.0)), 0.1)
    assert "an element of type Mute is beyond the limits of its theory at t = " in result.failure
    assert "describe_limit of Mute failed: ZeroDivisionError" in result.failure


@pytest.mark.parametrize("start", [None, "a text", [1, 2]])
def test_warnings_about_the_start_are_a_list_of_texts(start: Any) -> None:
    with pytest.raises(UserError, match=r"check_start of Mute returned .*; allowed: a list of texts"):
        mb.simulate(hung(Mute(force=1.0, start=start)), 0.1)


def test_the_positions_are_checked_wherever_bodies_are_assembled() -> None:
    with pytest.raises(UserError, match="too far out"):
        CompiledMechanism(bob(0.3, x=4.0)).assemble()
    with pytest.raises(UserError, match="too far out"):
        mb.simulate(bob(0.3, x=4.0), 0.1)
    with pytest.raises(UserError, match="too far out"):
        mb.equilibrium(bob(0.3, weight=1.0, x=4.0))


def test_the_start_is_checked_once() -> None:
    compiled = CompiledMechanism(bob(0.3, gravity=9.81))
    assert [found.text for found in compiled.check_start(0.0, compiled.assemble()[0])] == ["1 anchors, g = 9.81"]


def test_a_run_beyond_the_accurate_limit_warns_and_one_beyond_the_valid_limit_ends() -> None:
    assert "beyond the limits" not in mb.simulate(bob(0.49), 1.0).warning
    slow = mb.simulate(bob(0.6), 1.0)
    assert "an element of type Anchor is deformed beyond the limits of its theory at t = 0 s" in slow.warning
    thrown = bob(0.0, weight=-30.0)
    ended = mb.simulate(thrown, 5.0)
    assert "an element of type Anchor is deformed beyond the limits of its theory at t = " in ended.failure
    assert 0.0 < ended.t[-1] < 1.0
    assert ended["y"][-1] <= 0.8


def test_reasons_reach_the_choice_of_the_solver() -> None:
    m = bob(0.3)
    compiled = CompiledMechanism(m)
    assert compiled.system.nonsmooth_reason == "anchors jerk"
    assert compiled.system.stiffness_reason == "anchors are stiff"
    assert "anchors are stiff" in mb.Simulation(m, mb.Settings(solver="auto")).solver_choice.reason
    assert CompiledMechanism(mb_pendulum()).system.stiffness_reason == ""


def mb_pendulum() -> mb.Mechanism:
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    m.body("arm", m.ground, mb.Revolute(), **mb.rod(mass=1.0, length=1.0))
    return m


@pytest.mark.parametrize("count", [0, 2])
def test_an_element_needs_its_number_of_bodies(count: int) -> None:
    m = mb.Mechanism()
    bodies = [m.body(f"b{i}", m.ground, mb.Translational(axis="y"), mass=1.0) for i in range(count)]
    with pytest.raises(UserError, match="it needs 1 different bodies"):
        m.element(Anchor(law=Cubic(stiffness=1.0)), *bodies)


def test_an_element_is_a_load() -> None:
    m = mb.Mechanism()
    with pytest.raises(UserError, match="allowed: a Load"):
        m.element(mb.Revolute(), m.ground)  # type: ignore[arg-type]


@pytest.mark.parametrize(("value", "ratio"), [(0.0, 0.0), (0.25, 0.5), (0.5, 1.0), (0.65, 1.5), (0.8, 2.0), (1.1, 3.0)])
def test_the_ratio_is_one_at_the_accurate_limit_and_two_at_the_valid_limit(value: float, ratio: float) -> None:
    compiled = CompiledMechanism(bob(0.0))
    assert compiled.limit_ratio(0.0, np.array([value])) == pytest.approx(ratio, abs=1e-12)


def test_recorded_points_leave_the_session_as_points_that_a_run_stops_at() -> None:
    times = np.linspace(0.0, 0.3, 16)[1:]
    recorded, stopped = (mb.Simulation(bob(0.3), mb.Settings(solver="radau")) for _ in range(2))
    assert recorded.record(times, np.zeros((len(times), len(recorded.variables)))) == len(times)
    for t in times:
        assert stopped.advance(float(t)).ok
        stopped.outputs()
    assert recorded.session.status["limit_ratio"][0] > 0.0
    for one, other in zip(recorded.session.memory(), stopped.session.memory(), strict=True):
        assert one.tobytes() == other.tobytes()


@kernel
def no_force(load: Any, t: float, arrays: Any, state: Any) -> None:
    pass


@kernel
def misplacement(load: Any, arrays: Any, state: Any) -> float:
    return state.bodies[load.body].r[1] / 0.5


@dataclass(frozen=True, kw_only=True)
class Placed(Load):
    """Requires its body to be no higher than 0.5 m at the start, and does nothing."""

    record = np.dtype([("body", np.int64)])
    apply = no_force
    misplacement = misplacement
    n_bodies = 1
    title = "a shelf"

    def fill(self, record: Any, site: Any) -> None:
        (record["body"],) = site.bodies


@pytest.mark.parametrize("height", [0.4, 0.5, 0.6, 5.0])
def test_a_misplaced_load_is_refused_without_a_separate_check(height: float) -> None:
    m = mb.Mechanism()
    body = m.body("bob", m.ground, mb.Translational(axis="y", start=height, fixed=True), mass=2.0)
    m.element(Placed(), body)
    if height <= 0.5:
        assert mb.Simulation(m, mb.Settings(solver="radau")).advance(0.1).ok
        return
    found = f"'a shelf at bob' is misplaced at the start: its bodies are {height / 0.5:.3g} times as far"
    with pytest.raises(UserError, match=found):
        mb.Simulation(m, mb.Settings(solver="radau"))
