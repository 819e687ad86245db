"""Parameters that stay settable without build(): what they move is what compiled mechanisms built with them have."""

from dataclasses import dataclass
from functools import cache
from math import asin, atan2, cos, hypot, inf, sin, sqrt

import numpy as np
import pytest

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from fmus.sheet import Sheet
from mbfmu.mechanics import (
    DistanceCutJoint,
    DistanceStop,
    Input,
    JointForce,
    JointSpring,
    JointStop,
    Mechanism,
    Revolute,
    RevoluteCutJoint,
    Translational,
    rod,
)
from mbfmu.modeling import Model, parameter
from mbfmu.native.model_numbers import STRUCTURE_REASON, Place, Reader
from mbfmu.native.parameters import SettableParameters, find_settable
from mbfmu.util.errors import UserError

SHIPPED = {
    "four-bar": FourBar(),
    "elastic four-bar": FourBar(coupler_modes=2),
    "governor": Governor(),
    "free governor": Governor(driven=False),
    "pendulum": SwingPendulum(),
    "small sheet": Sheet(nx=5, nz=4),
    "damped sheet": Sheet(nx=5, nz=4, damping=0.002, drag=1.4),
    "free sheet": Sheet(nx=5, nz=4, support="free"),
    "sheet": Sheet(),
}
STRUCTURAL = {
    FourBar: {"coupler_modes"},
    Governor: {"driven"},
    SwingPendulum: set(),
    Sheet: {
        *("nx", "nz", "tree", "support", "slide", "membrane", "stretch", "grid_outputs", "field", "load"),
        *("length", "width", "pressure", "youngs_modulus_cross", "shear_modulus", "curl_x", "curl_z"),
    },
}
MORE = {
    "elastic four-bar": {
        *("coupler_length", "coupler_mass", "coupler_height", "coupler_width", "youngs_modulus", "coupler_elements"),
    },
    "small sheet": {"held_part", "damping", "drag"},
    "damped sheet": {"held_part"},
    "free sheet": {"damping", "drag"},
    "sheet": {"held_part", "damping", "drag"},
}

NEAR = 0.04  # of first guesses: 2 % of the largest, which is at most twice that of the model


@cache
def searched(model: Model) -> SettableParameters:
    return find_settable(model)


def drawn(live: SettableParameters, random: np.random.Generator) -> dict[str, float]:
    """Return values at random within the ranges: where these have no end, within a decade."""
    values = {}
    for name in live.parameters:
        low, high = live.ranges[name]
        if isinstance(live.start[name], int):  # also a Boolean
            values[name] = int(random.integers(low, high + 1))
            continue
        size = abs(live.start[name]) or 1.0
        values[name] = float(random.uniform(max(low, -10.0 * size), min(high, 10.0 * size)))
    return values


def check_entries(model: Model, live: SettableParameters, values: dict[str, float]) -> None:
    """Hold what follows parameters, and what does not, against a compiled mechanism built with them."""
    reader = Reader(model)
    built = dict(zip(reader.places, reader.read(values), strict=True))
    found = live.apply(values)
    guesses = {entry.place for entry in live.entries if entry.guess}
    terms = {entry.place: largest_term(live, entry, values) for entry in live.entries}
    for place, value, base in zip(reader.places, built.values(), reader.base, strict=True):
        if place.array in ("span", "drive size", "drive rate"):
            continue
        wanted = found.get(place, base)
        allowed = NEAR * abs(base) if place in guesses else 4e-12 * max(abs(value), terms.get(place, 0.0))
        assert abs(wanted - value) <= allowed, (place, wanted, value)


def largest_term(live: SettableParameters, entry, values: dict[str, float]) -> float:
    """Return by how much rounding of a sum is compared: its largest term; of one term or a root its value."""
    if entry.root != 1 or len(entry.sums[0]) == 1:
        return 0.0
    return max(abs(term.value({**live.start, **values})) for term in entry.sums[0])


@pytest.mark.parametrize("name", SHIPPED)
def test_entries_are_the_arrays_of_plants_built_with_other_values(name):
    model = SHIPPED[name]
    live = searched(model)
    check_entries(model, live, {})
    random = np.random.default_rng(7)
    for _ in range(20):
        check_entries(model, live, drawn(live, random))


@pytest.mark.parametrize("name", SHIPPED)
def test_which_parameters_of_shipped_models_stay_settable(name):
    model = SHIPPED[name]
    live = searched(model)
    assert set(live.fixed) == STRUCTURAL[type(model)] | MORE.get(name, set())
    assert set(live.parameters) | set(live.fixed) == {p.name for p in model.parameters()}
    for p in model.parameters():
        if p.name in live.ranges:
            low, high = live.ranges[p.name]
            assert p.min <= low <= getattr(model, p.name) <= high <= p.max


def test_a_parameter_at_zero_that_turns_something_on_is_frozen_with_a_hint():
    live = searched(SHIPPED["small sheet"])
    assert live.fixed["damping"].startswith(STRUCTURE_REASON)
    assert "export with another value than zero" in live.fixed["damping"]
    on = searched(SHIPPED["damped sheet"])
    assert 0.0 < on.ranges["damping"][0] < 0.002
    assert on.ranges["damping"][1] == inf


def test_a_reason_names_what_is_not_represented():
    reason = searched(SHIPPED["elastic four-bar"]).fixed["coupler_height"]
    assert reason.startswith("a flexible body follows it in a way that a native FMU cannot represent")


def test_products_are_found_as_they_are_written():
    live = searched(SHIPPED["four-bar"])
    told = {entry.place: entry for entry in live.entries}
    bodies = {term for place, entry in told.items() if place.array == "bodies" for term in entry.sums[0]}
    assert {(1 / 12, (("crank_length", 2.0), ("crank_mass", 1.0)))} <= {(t.coefficient, t.powers) for t in bodies}
    assert all(entry.root == 1 and len(entry.sums) == 1 for place, entry in told.items() if place.array == "bodies")
    assert all(live.ranges[n] == (-inf, inf) for n in ("gravity", "start_angle", "start_rate", "crank_torque"))


def test_what_an_input_owns_follows_its_parameter_as_a_start():
    assert {e.input for e in searched(SHIPPED["four-bar"]).entries} == {None, 0}
    live, compiled = searched(SHIPPED["small sheet"]), SHIPPED["small sheet"].compile()
    owned = {e.place: compiled.inputs.variables[e.input].name for e in live.entries if e.input is not None}
    assert owned == {Place("world", 8 * k): f"gravity.{axis}" for k, axis in enumerate("xyz")}


def test_length_and_rate_follow_the_largest():
    model = FourBar()
    live = searched(model)
    for values in ({"ground_length": 7.0}, {"coupler_length": 5.0, "gravity": -1.62}, {"crank_length": 9.0}):
        compiled = model.with_values(values).compile()
        found = live.apply(values)
        assert found[Place("length", 0)] == pytest.approx(compiled.length, rel=1e-14)
        assert found[Place("rate", 0)] == pytest.approx(compiled.system.rate, rel=1e-14)
        assert found[Place("loop_rate", 0)] == pytest.approx(compiled.system.loop_rate, rel=1e-14)


def test_a_unit_with_a_bound_follows_on_both_sides_of_it():
    model = SHIPPED["small sheet"]
    live = searched(model)
    entry = next(e for e in live.entries if e.place == Place("size", 8))
    assert entry.root < 0
    thick, thin = ({"thickness": model.thickness * k} for k in (5.0, 0.5))
    for values in (thick, thin):
        wanted = model.with_values(values).compile().system.size[1]
        assert live.apply(values)[entry.place] == pytest.approx(wanted, rel=1e-13)
    assert live.apply(thick)[entry.place] < live.apply(thin)[entry.place]


@dataclass(frozen=True, kw_only=True)
class Odd(Model):
    """A pendulum whose build() does what no product does."""

    length: float = parameter(1.0, unit="m", min=1e-3)
    mass: float = parameter(2.0, unit="kg", min=1e-3)
    bent: float = parameter(1.0, min=0.0)  # max() with a kink a little above its value
    far: float = parameter(1.0, min=0.0)  # ... and far away
    farther: float = parameter(1.0, min=0.0)  # ... and farther
    side: float = parameter(1.0)
    rooted: float = parameter(3.0, min=0.0)
    curved: float = parameter(2.0, min=0.0)
    whole: float = parameter(3.0, min=1.0, max=50.0)
    count: int = parameter(2, min=1, max=5)
    summed: float = parameter(0.5)
    refused: float = parameter(1.5, min=0.0)
    damping: float = parameter(0.0, min=0.0)
    never: float = parameter(0.0)

    def build(self) -> Mechanism:
        """Return the mechanism."""
        if self.refused > 2.0:
            raise UserError(f"refused is {self.refused!r}; allowed: at most 2")
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        bar = m.body("bar", m.ground, Revolute(start=self.summed - 0.25), **rod(mass=self.mass, length=self.length))
        slider = m.body("slider", bar, Translational(axis="x", start=2.0), mass=sqrt(self.rooted) * self.mass)
        for k in range(int(self.whole)):
            m.force(f"part {k}", JointForce(magnitude=0.1), bar)
        for k in range(self.count):
            m.force(f"more {k}", JointForce(magnitude=0.1), bar)
        m.force("bent", JointSpring(stiffness=max(self.bent, 1.1)), bar)
        m.force("far", JointSpring(stiffness=min(self.far, 5.0)), bar)
        m.force("farther", JointSpring(stiffness=min(self.farther, 1e5)), bar)
        m.force("side", JointSpring(stiffness=2.0 if self.side > 0.0 else 3.0, damping=abs(self.side)), bar)
        m.force("curved", JointSpring(stiffness=1.0 / (1.0 + self.curved)), slider)
        m.force("refused", JointSpring(stiffness=self.refused * (1.0 + self.mass)), slider)
        if self.damping > 0.0:
            m.force("damper", JointSpring(stiffness=0.0, damping=self.damping), slider)
        torque = Input(name="torque", unit="N.m", start=2.0 * self.never)
        m.force("motor", JointForce(magnitude=torque), bar)
        m.output("angle", bar.angle(), "angle")
        return m


def test_what_is_no_product_is_frozen_or_ranged():
    model = Odd()
    live = find_settable(model)
    assert set(live.fixed) == {"whole", "count", "damping"}
    assert live.fixed["whole"] == STRUCTURE_REASON
    assert "another value than zero" in live.fixed["damping"]
    assert live.fixed["count"] == STRUCTURE_REASON
    assert live.ranges["bent"][1] <= 1.1
    assert live.ranges["curved"] == (1.0, 4.0)
    assert 1.0 < live.ranges["far"][1] <= 5.0
    assert 5.0 < live.ranges["farther"][1] <= 1e5
    assert live.ranges["side"][0] > 0.0
    assert 1.5 <= live.ranges["refused"][1] <= 2.0
    assert live.ranges["rooted"] == (0.0, inf)
    assert live.ranges["never"] == (-inf, inf)
    random = np.random.default_rng(3)
    for _ in range(20):
        check_entries(model, live, drawn(live, random))


@dataclass(frozen=True, kw_only=True)
class Ordered(Model):
    """One whose parameters must be in an order."""

    short: float = parameter(1.0, unit="m", min=0.1)
    long: float = parameter(1.2, unit="m", min=0.1)

    def build(self) -> Mechanism:
        """Return the mechanism."""
        if self.short > self.long:
            raise UserError(f"short is {self.short!r} m; allowed: at most long, {self.long!r} m")
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        m.body("bar", m.ground, Revolute(), **rod(mass=self.long - self.short + 1.0, length=self.long))
        return m


def test_ranges_of_parameters_that_are_refused_together_are_of_points_that_do():
    live = find_settable(Ordered())
    random = np.random.default_rng(3)
    for _ in range(20):
        check_entries(Ordered(), live, drawn(live, random))


def test_a_model_that_cannot_be_built_is_refused():
    with pytest.raises(UserError, match=r"refused is 3\.0"):
        find_settable(Odd(refused=3.0))


@dataclass(frozen=True, kw_only=True)
class Stopped(Model):
    """A mass that falls onto a floor, or is connected to a rope: stops with one end, the other at infinity."""

    depth: float = parameter(0.5, unit="m", min=0.0)
    rope: float = parameter(2.0, unit="m", min=0.0)

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        body = m.body("mass", m.ground, Translational(axis="y"), mass=1.0)
        m.force("floor", JointStop(lower=-self.depth, stiffness=1e4), body)
        m.force("rope", DistanceStop(upper=self.rope, stiffness=1e4), body, m.ground)
        m.output("height", body.coordinate())
        return m


def test_a_stop_at_infinity_stays_there_and_the_other_one_follows_its_parameter():
    live = searched(Stopped())
    assert set(live.parameters) >= {"depth", "rope"}
    check_entries(Stopped(), live, {"depth": 0.9, "rope": 1.2})


@dataclass(frozen=True, kw_only=True)
class Choices(Model):
    """A slider-crank whose numbers are no sums of products of powers, with whole numbers and Booleans."""

    crank: float = parameter(0.3, unit="m", min=0.01)
    rod: float = parameter(0.8, unit="m", min=0.01)
    angle: float = parameter(0.4, unit="rad", min=-1.0, max=1.0)
    mass: float = parameter(2.0, unit="kg", min=0.1)
    slope: float = parameter(0.2, unit="rad", min=-1.0, max=1.0)
    teeth: int = parameter(20, min=10, max=60)
    holes: int = parameter(2, min=0, max=5)
    is_heavy: bool = parameter(False)
    is_damped: bool = parameter(False)  # adds an element

    def build(self) -> Mechanism:
        """Return the mechanism: the slider moves along x at the height of the crank's axis."""
        m = Mechanism(gravity=(9.81 * sin(self.slope), -9.81 * cos(self.slope), 0.0))
        crank = m.body("crank", m.ground, Revolute(start=self.angle, fixed=True), **rod(mass=1.0, length=self.crank))
        lean = -asin(self.crank * sin(self.angle) / self.rod) - self.angle
        link = m.body("link", crank, Revolute(at=(self.crank, 0, 0), start=lean), **rod(mass=1.0, length=self.rod))
        weight = self.mass * (7.8 if self.is_heavy else 2.7) - 0.1 * self.holes**1.5
        slider = m.body("slider", m.ground, Translational(axis="x", start=self.crank + self.rod), mass=weight)
        m.cut("pin", RevoluteCutJoint(at_a=(self.rod, 0, 0)), link, slider)
        m.force("motor", JointForce(magnitude=Input(name="torque", unit="N.m", start=100.0 / self.teeth)), crank)
        if self.is_damped:
            m.force("damper", JointSpring(damping=1.0), slider)
        m.output("x", slider.coordinate())
        return m


def test_smooth_numbers_whole_numbers_and_booleans_stay_settable():
    live = searched(Choices())
    assert live.fixed == {"is_damped": STRUCTURE_REASON}
    assert live.ranges["teeth"] == (16, 24)
    lightest, most = live.ranges["mass"][0], live.ranges["holes"][1]
    assert live.ranges["holes"][0] == 0
    assert 2 < most <= 5
    assert 2.7 * lightest - 0.1 * most**1.5 > 0.0  # with more holes the slider has no mass
    assert live.ranges["is_heavy"] == (0, 1)
    random = np.random.default_rng(5)
    for _ in range(20):
        check_entries(Choices(), live, drawn(live, random))


@dataclass(frozen=True, kw_only=True)
class Loose(Model):
    """A loop with one degree of freedom whose start values are all first guesses, and a slider outside of it."""

    rise: float = parameter(0.3, unit="m", min=0.01, max=1.0)
    run: float = parameter(0.9, unit="m", min=0.01, max=2.0)

    def build(self) -> Mechanism:
        """Return the mechanism."""
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        free = m.body("free", m.ground, Translational(axis="x", start=hypot(self.rise, self.run)), mass=1.0)
        a = m.body("a", m.ground, Revolute(start=atan2(self.rise, self.run)), **rod(mass=1.0, length=1.0))
        b = m.body(
            "b", m.ground, Revolute(at=(1.0, 0, 0), start=atan2(self.rise, self.run)), **rod(mass=1.0, length=1.0)
        )
        m.cut("coupler", DistanceCutJoint(length=1.0, at_a=(1.0, 0, 0), at_b=(1.0, 0, 0)), a, b)
        m.output("x", free.coordinate())
        return m


def test_a_first_guess_on_which_the_closed_position_depends_is_represented_exactly():
    live = searched(Loose())
    assert not live.fixed
    random = np.random.default_rng(5)
    for _ in range(20):
        values = drawn(live, random)
        exact = Loose(**values).compile().assembly.start_positions()
        found = live.apply(values)
        assert [found[Place("q", 8 * k)] for k in range(3)] == pytest.approx(exact, rel=1e-11)
