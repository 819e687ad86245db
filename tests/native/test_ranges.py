"""Ranges of settable parameters of models that branch at a distance from the values of the export."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations, product
from math import cos, inf, sin

import numpy as np
import pytest

from mbfmu.mechanics import DistanceCutJoint, JointForce, JointSpring, Mechanism, Revolute, Translational, rod
from mbfmu.modeling import Model, parameter
from mbfmu.native.parameters import find_settable
from mbfmu.native.validity_range import pairs_of_sides

Law = Callable[[float, float, float], float]


def laws() -> dict[str, Law]:
    """Return forces of (a, b, kink), which branch at a distance from a = b = 1 that is given by ``kink``."""
    return {
        "limited product": lambda a, b, limit: min(a * b, limit),
        "larger of two": lambda a, b, limit: max(a, limit * b),
        "added beyond": lambda a, b, limit: a * b + max(0.0, a - limit * b),
        "sum decides": lambda a, b, limit: a * b if a + b < 2.0 * limit else 2.0 * a * b,
        "one decides": lambda a, b, limit: a + b if a < limit else 2.0 * (a + b),
    }


def pushed_by(law: Callable[[float, float], float]) -> Model:
    """Return the model of a body on a rail that is pushed by a force of two parameters."""

    @dataclass(frozen=True, kw_only=True)
    class Pushed(Model):
        a: float = parameter(1.0)
        b: float = parameter(1.0)

        def build(self) -> Mechanism:
            m = Mechanism(gravity=(0.0, 0.0, 0.0))
            body = m.body("body", m.ground, Translational(axis="x"), mass=1.0)
            m.force("push", JointForce(law(self.a, self.b)), body)
            return m

    return Pushed()


@pytest.mark.parametrize("kink", [1.3, 2.6, 5.0, 8.0])
@pytest.mark.parametrize("law", laws())
def test_numbers_within_the_ranges_are_those_of_models_built_with_them(law: str, kink: float) -> None:
    def force(a: float, b: float) -> float:
        return laws()[law](a, b, kink)

    live, random = find_settable(pushed_by(force)), np.random.default_rng(5)
    (entry,) = live.entries
    factors = np.geomspace(1.0 / 12.0, 12.0, 41)
    inside = {n: [x for x in factors if low <= x <= high] for n, (low, high) in live.ranges.items()}
    points = [{n: x} for n in inside for x in inside[n]]
    points += [{n: float(random.choice(inside[n])) for n in inside} for _ in range(200)]
    for point in points:
        values = {"a": 1.0, "b": 1.0} | point
        assert live.apply(values)[entry.place] == pytest.approx(force(**values), rel=1e-9), values
    assert set(inside) == {"a", "b"}


@pytest.mark.parametrize(("branch", "least"), [(0.0, 1e-6), (1e-4, 1e-3), (0.05, 0.1)])
def test_a_parameter_for_which_zero_is_another_model_can_be_set_near_zero(branch: float, least: float) -> None:
    """At and below the branch, the body is pushed by another number, as by a controller without one of its parts."""

    def force(a: float, b: float) -> float:
        return a * b if a > branch else 3.0

    low, _ = find_settable(pushed_by(force)).ranges["a"]
    assert 0.5 * least < low < 2.0 * least


@pytest.mark.parametrize("count", [2, 3, 4, 5, 10, 11, 16, 40])
def test_every_two_columns_have_all_pairs(count: int) -> None:
    rows = pairs_of_sides(count)
    assert rows.shape[0] <= 10
    for i, j in combinations(range(count), 2):
        assert set(zip(rows[:, i].tolist(), rows[:, j].tolist(), strict=True)) == set(product((0, 1), (0, 1)))


@dataclass(frozen=True, kw_only=True)
class Inclined(Model):
    """A pendulum in a loop on an inclined plane: the rate of its motion follows from a gravity that is no product."""

    gravity: float = parameter(9.81, unit="m/s2", min=0.0)
    slope: float = parameter(0.3, unit="rad")
    stiffness: float = parameter(5.0, min=0.0)

    def build(self) -> Mechanism:
        """Return the mechanism."""
        g, slope = self.gravity, self.slope
        m = Mechanism(gravity=(0.3 * g * sin(slope), -g * cos(slope), 0.5))
        bar = m.body("bar", m.ground, Revolute(start=0.4), **rod(mass=1.0, length=0.5))
        m.force("spring", JointSpring(stiffness=self.stiffness), bar)
        slider = m.body("slider", m.ground, Translational(axis="x", start=0.5), mass=1.0)
        m.cut("rope", DistanceCutJoint(at_a=(0.5, 0.0, 0.0), length=0.7), bar, slider)
        return m


def test_a_rate_made_of_smooth_functions_leaves_parameters_settable() -> None:
    live = find_settable(Inclined())
    assert set(live.parameters) == {"gravity", "slope", "stiffness"}
    assert live.ranges["stiffness"] == (0.0, inf)
    low, high = live.ranges["slope"]
    assert low < 0.2
    assert high > 0.4
    places = {entry.place.offset // 8: entry.place for entry in live.entries if entry.place.array == "world"}
    for gravity, slope in ((9.81, 0.2), (3.0, 0.4), (20.0, 0.35)):
        found = live.apply({"gravity": gravity, "slope": slope})
        assert found[places[0]] == pytest.approx(0.3 * gravity * sin(slope), rel=1e-10)
        assert found[places[1]] == pytest.approx(-gravity * cos(slope), rel=1e-10)
