"""The check of user-defined elements passes right ones, and names what is wrong with wrong ones."""

from __future__ import annotations

import re
import runpy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import Coupling, Force, Load, Sensor, kernel, scratch_record
from mbfmu.sheets import Surface
from mbfmu.testing import ElementReport, Outcome, check_element
from mbfmu.testing.identities import Deviation

RECORD = np.dtype([("body", np.int64), ("c", np.float64)])


@dataclass(frozen=True, kw_only=True)
class Uniform(Force):
    """A spring from the origin of a body to that of the ground, with an error or without."""

    record = RECORD
    c: float = 3.0

    def fill(self, record: Any, site: Any) -> None:
        record["body"], record["c"] = site.bodies[0], self.c


@kernel
def pull(force: Any, t: float, arrays: Any, state: Any) -> None:
    body = state.bodies[force.body]
    for k in range(3):
        body.F[k] -= force.c * body.r[k]


@kernel
def stored(force: Any, arrays: Any, state: Any) -> Any:
    r = state.bodies[force.body].r
    return 0.5 * force.c * (r[0] * r[0] + r[1] * r[1] + r[2] * r[2])


@kernel
def stored_twice(force: Any, arrays: Any, state: Any) -> Any:
    r = state.bodies[force.body].r
    return force.c * (r[0] * r[0] + r[1] * r[1] + r[2] * r[2])


@kernel
def drag(force: Any, t: float, arrays: Any, state: Any) -> None:
    body = state.bodies[force.body]
    for k in range(3):
        body.F[k] -= force.c * body.Y[k]


@kernel
def loss(force: Any, t: float, arrays: Any, state: Any) -> Any:
    Y = state.bodies[force.body].Y
    return -force.c * (Y[0] * Y[0] + Y[1] * Y[1] + Y[2] * Y[2])


@kernel
def gain(force: Any, t: float, arrays: Any, state: Any) -> Any:
    Y = state.bodies[force.body].Y
    return force.c * (Y[0] * Y[0] + Y[1] * Y[1] + Y[2] * Y[2])


@kernel
def of_real_part(force: Any, t: float, arrays: Any, state: Any) -> None:
    body = state.bodies[force.body]
    for k in range(3):
        body.F[k] -= force.c * body.r[k].real


class Right(Uniform):
    apply, potential = pull, stored


class Damper(Uniform):
    apply, power = drag, loss


class WrongPotential(Uniform):
    apply, potential = pull, stored_twice


class WrongPower(Uniform):
    apply, power = drag, gain


class NotAnalytic(Uniform):
    apply, potential = of_real_part, stored


@kernel
def viscous(force: Any, t: float, arrays: Any, state: Any) -> None:
    body = state.bodies[force.body]
    for k in range(3):
        body.F[k] -= force.c * (body.r[k] + 0.3 * body.r[k] * body.r[k] * body.Y[k])


@kernel
def viscous_loss(force: Any, t: float, arrays: Any, state: Any) -> Any:
    r, Y = state.bodies[force.body].r, state.bodies[force.body].Y
    return -0.3 * force.c * ((r[0] * Y[0]) ** 2 + (r[1] * Y[1]) ** 2 + (r[2] * Y[2]) ** 2)


@kernel
def viscous_tangent(force: Any, c1: float, arrays: Any, state: Any, perturbed: Any, K: Any) -> float:
    body = state.bodies[force.body]
    for k in range(3):
        K[k, k] += force.c * (1.0 + 0.6 * body.r[k] * body.Y[k] + c1 * 0.3 * body.r[k] * body.r[k])
    return 1.0


@kernel
def tangent_at_rest(force: Any, c1: float, arrays: Any, state: Any, perturbed: Any, K: Any) -> float:
    body = state.bodies[force.body]
    for k in range(3):
        K[k, k] += force.c * (1.0 + 0.6 * body.r[k] * body.Y[k])
    return 1.0


@kernel
def tangent_that_overwrites(force: Any, c1: float, arrays: Any, state: Any, perturbed: Any, K: Any) -> float:
    body = state.bodies[force.body]
    for k in range(3):
        K[k, k] = force.c * (1.0 + 0.6 * body.r[k] * body.Y[k] + c1 * 0.3 * body.r[k] * body.r[k])
    return 1.0


@kernel
def tangent_that_is_not_used(force: Any, c1: float, arrays: Any, state: Any, perturbed: Any, K: Any) -> float:
    viscous_tangent(force, c1, arrays, state, perturbed, K)
    return 0.0


@dataclass(frozen=True, kw_only=True)
class Viscous(Load):
    """A spring and a damper at the origin of a body."""

    record = RECORD
    apply, potential, power, tangent = viscous, stored, viscous_loss, viscous_tangent
    c: float = 3.0

    def fill(self, record: Any, site: Any) -> None:
        record["body"], record["c"] = site.bodies[0], self.c


class WrongTangent(Viscous):
    tangent = tangent_at_rest


class OverwritingTangent(Viscous):
    tangent = tangent_that_overwrites


class UnusedTangent(Viscous):
    tangent = tangent_that_is_not_used


SQUARES = np.dtype([("total", np.float64), ("calls", np.int64)])


@kernel
def square_of_distance(load: Any, state: Any) -> Any:
    work, r = scratch_record(load.scratch, SQUARES, state), state.bodies[load.body].r
    work.total = 0.0 * r[0]
    for k in range(3):
        work.total += r[k] * r[k]
    work.calls += 1
    return work.total


@kernel
def stored_by_scratch(load: Any, arrays: Any, state: Any) -> Any:
    return 0.5 * load.c * square_of_distance(load, state)


@kernel
def stored_by_leftovers(load: Any, arrays: Any, state: Any) -> Any:
    return 0.5 * load.c * scratch_record(load.scratch, SQUARES, state).total


@kernel
def pull_and_measure(load: Any, t: float, arrays: Any, state: Any) -> None:
    square_of_distance(load, state)
    pull(load, t, arrays, state)


@kernel
def remoteness(load: Any, arrays: Any, state: Any) -> Any:
    return square_of_distance(load, state)


@kernel
def nearness(load: Any, arrays: Any, state: Any) -> Any:
    return 0.01 - square_of_distance(load, state)


@kernel
def depth_of_ground(load: Any, arrays: Any, state: Any) -> Any:
    return np.sqrt(-square_of_distance(load, state))


@dataclass(frozen=True, kw_only=True)
class Measured(Load):
    """The spring, with scratch memory and a limit, and perhaps another load on its body."""

    record = np.dtype([("body", np.int64), ("scratch", np.int64), ("c", np.float64)])
    apply, potential, monitor = pull_and_measure, stored_by_scratch, remoteness
    n_bodies = 1
    with_it: Any = None

    def fill(self, record: Any, site: Any) -> None:
        record["body"], record["scratch"], record["c"] = site.bodies[0], site.scratch(SQUARES), 3.0

    def companions(self) -> tuple[Any, ...]:
        return () if self.with_it is None else (self.with_it,)


class Leftover(Measured):
    potential = stored_by_leftovers


class Negative(Measured):
    monitor = nearness


class NoNumber(Measured):
    monitor = depth_of_ground


@kernel
def square(record: Any, x: Any, arrays: Any) -> Any:
    return x * x, 2.0 * x, 2.0 + 0.0 * x


@kernel
def square_of_slope_x(record: Any, x: Any, arrays: Any) -> Any:
    return x * x, x, 1.0 + 0.0 * x


@dataclass(frozen=True, kw_only=True)
class Square(Coupling):
    evaluate = square


@dataclass(frozen=True, kw_only=True)
class WrongSlope(Coupling):
    evaluate = square_of_slope_x


@pytest.mark.parametrize(
    "element",
    [
        Right(),
        Damper(),
        Viscous(),
        Measured(),
        Measured(with_it=Viscous()),
        Square(),
        mb.Screw(lead=0.1),
        mb.SphericalCutJoint(),
    ],
    ids=lambda item: type(item).__name__,
)
def test_a_right_element_passes(element: Any) -> None:
    report = check_element(element, states=3, bodies=1)
    assert report.passed
    assert all(outcome.examined for outcome in report.outcomes.values())
    assert "FAILED" not in str(report)


@pytest.mark.parametrize(
    ("element", "identity", "cause"),
    [
        (WrongPotential(), "energy, potential and power", "`potential`"),
        (WrongPower(), "energy, potential and power", "`power`"),
        (NotAnalytic(), "complex steps", "not analytic"),
        (WrongSlope(), "derivatives of constraints", "derivatives of a coupling"),
        (WrongTangent(), "tangents of loads", "`tangent`"),
        (OverwritingTangent(), "tangents of loads", "`tangent`"),
        (UnusedTangent(), "tangents of loads", "`tangent`"),
        (Measured(with_it=WrongTangent()), "tangents of loads", "wrongtangent on load 'element'"),
        (Leftover(), "limits and scratch memory", "after a call in another state"),
        (Negative(), "limits and scratch memory", "`monitor`"),
        (NoNumber(), "limits and scratch memory", "`monitor`"),
    ],
    ids=lambda item: type(item).__name__ if not isinstance(item, str) else "",
)
def test_a_wrong_element_is_named_with_its_cause(element: Any, identity: str, cause: str) -> None:
    with pytest.raises(AssertionError) as raised:
        check_element(element, states=3, bodies=1)
    text = str(raised.value)
    failed = [line for line in text.splitlines() if " FAILED " in line]
    assert any(line.startswith(identity) for line in failed)
    assert "passed" in text  # not everything fails
    reason = next(line for line in text.splitlines() if line.startswith(f"{identity}: "))
    assert "instead of" in reason
    assert cause in reason


def test_a_companion_that_is_no_load_is_refused() -> None:
    with pytest.raises(mb.UserError, match=r"companion of load 'element' is 3\.0; allowed: a Load"):
        check_element(Measured(with_it=3.0), bodies=1)


def test_the_elements_of_the_page_pass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[1] / "docs" / "extending.md").read_text()
    pages = dict(re.findall(r"```python file=(\S+)\n(.*?)```", page, flags=re.DOTALL))
    monkeypatch.chdir(tmp_path)
    for file, name, options in (
        ("lamp.py", "AirDrag", {"drag": 0.3}),
        ("roller.py", "Rolling", {"radius": 0.1}),
        ("ball.py", "Ball", {"radius": 0.05}),
        ("strap.py", "Strap", {"length": 0.2, "stiffness": 100.0}),
    ):
        Path(file).write_text(pages[file])
        element = runpy.run_path(file)[name](**options)
        assert isinstance(check_element(element, states=4), ElementReport)


def test_a_wrong_potential_between_two_bodies_is_found(tmp_path: Path) -> None:
    """Their origins change their distance: else no force along the line between them does work."""
    page = (Path(__file__).parents[1] / "docs" / "extending.md").read_text()
    file = tmp_path / "strap.py"
    file.write_text(dict(re.findall(r"```python file=(\S+)\n(.*?)```", page, flags=re.DOTALL))["strap.py"])
    page_names = runpy.run_path(str(file))
    right = page_names["potential"]

    @kernel
    def doubled(strap: Any, arrays: Any, state: Any) -> Any:
        return 2.0 * right(strap, arrays, state)

    class Wrong(page_names["Strap"]):  # type: ignore[misc]
        potential = doubled

    with pytest.raises(AssertionError, match="potential"):
        check_element(Wrong(length=0.01, stiffness=100.0), states=4)


@kernel
def ball_gap(ball: Any, contact: Any) -> Any:
    p, n = contact.p, contact.n
    distance = np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    for k in range(3):
        n[k] = p[k] / distance
    return distance - ball.radius


@kernel
def difference_of_squares(ball: Any, contact: Any) -> Any:
    gap = ball_gap(ball, contact)
    return gap * (gap + 2.0 * ball.radius) / (2.0 * ball.radius)


@kernel
def with_inner_normal(ball: Any, contact: Any) -> Any:
    gap = ball_gap(ball, contact)
    for k in range(3):
        contact.n[k] = -contact.n[k]
    return gap


@kernel
def with_long_normal(ball: Any, contact: Any) -> Any:
    gap = ball_gap(ball, contact)
    contact.n[0] = 1.01 * contact.n[0]
    return gap


@kernel
def of_real_point(ball: Any, contact: Any) -> Any:
    p, gap = contact.p, ball_gap(ball, contact)
    return np.sqrt(p[0].real ** 2 + p[1].real ** 2 + p[2].real ** 2) - ball.radius + 0.0 * gap


@kernel
def outside_of_arrays(ball: Any, contact: Any) -> Any:
    gap = ball_gap(ball, contact)
    contact.n[ball.count] = gap
    return gap


@kernel
def cavity(ball: Any, contact: Any) -> Any:
    gap = ball_gap(ball, contact)
    for k in range(3):
        contact.n[k] = -contact.n[k]
    return -gap


@dataclass(frozen=True, kw_only=True)
class Ball(Surface):
    record = np.dtype([("radius", np.float64), ("count", np.int64)])
    gap = ball_gap
    convex = True
    declared: float = 20.0  # 1/m
    depth: float = 0.05  # m
    ends: Any = None

    def fill(self, record: Any, site: Any) -> None:
        record["radius"], record["count"] = 0.05, 3

    def curvature(self) -> float:
        return self.declared

    def core(self) -> float:
        return self.depth

    def edges(self) -> Any:
        return self.ends


class Quadratic(Ball):
    gap = difference_of_squares


class InnerNormal(Ball):
    gap = with_inner_normal


class LongNormal(Ball):
    gap = with_long_normal


class RealPoint(Ball):
    gap = of_real_point


class OutsideOfArrays(Ball):
    gap = outside_of_arrays


class Cavity(Ball):
    gap = cavity


SURFACES = [
    Ball(),
    mb.Wall(at=(0.1, 0.0, 0.2), normal=(0.1, 1.0, -0.2)),
    mb.Drum(radius=0.2, length=0.5, at=(0.15, -0.2, 0.1), axis=(0.1, 0.0, 1.0)),
    mb.Trough(radius=0.4, length=0.5, angle=2.5, towards=(0.0, -1.0, 0.0), at=(0.15, 0.4, 0.1)),
    mb.Guide(start=(0.05, -0.01, 0.1), end=(0.2, -0.01, 0.1), radius=0.01, width=0.5),
]


@pytest.mark.parametrize("surface", SURFACES, ids=lambda item: type(item).__name__)
def test_a_right_surface_passes(surface: Surface) -> None:
    report = check_element(surface, length=0.3)
    assert "FAILED" not in str(report)
    assert all(outcome.examined >= 5 for outcome in report.outcomes.values())


@pytest.mark.parametrize(
    ("surface", "identity", "text"),
    [
        (Quadratic(), "distance from the surface", "kernel `gap`"),
        (InnerNormal(), "normal of the surface", "component"),
        (LongNormal(), "normal of the surface", "length of the normal"),
        (RealPoint(), "complex steps", "derivative of the distance"),
        (OutsideOfArrays(), "normal of the surface", "IndexError"),
        (Ball(declared=0.0), "shape of the surface", "is 20 instead of 0"),
        (Ball(depth=0.06), "distance from the surface", "core()"),
        (Ball(ends=(0.05, 1.0, (0.0, 0.0, 1.0))), "shape of the surface", "along the axis of edges()"),
        (Cavity(), "shape of the surface", "tangent plane"),
    ],
    ids=lambda item: type(item).__name__ if isinstance(item, Surface) else "",
)
def test_a_wrong_surface_is_named_with_its_cause(surface: Surface, identity: str, text: str) -> None:
    with pytest.raises(AssertionError) as raised:
        check_element(surface, length=0.1)
    reasons = [line for line in str(raised.value).splitlines() if line.startswith(f"{identity}: ")]
    assert len(reasons) == 1
    assert text in reasons[0]


def test_a_surface_that_is_nowhere_has_not_passed() -> None:
    with pytest.raises(AssertionError, match="nothing could be compared"):
        check_element(mb.Drum(radius=0.01, length=1e-6), states=2)


def test_outputs_of_a_mechanism_are_checked() -> None:
    @kernel
    def read(sensor: Any, lam: Any, arrays: Any, state: Any) -> Any:
        return np.sqrt(state.bodies[sensor.index].r[0].real ** 2)

    @dataclass(frozen=True, kw_only=True)
    class Distance(Sensor):
        pass

    Distance.read = read
    m = mb.Mechanism(gravity=(0, -9.81, 0))
    arm = m.body("arm", m.ground, mb.Revolute(), **mb.rod(mass=1.0, length=1.0))
    tip = m.body("tip", arm, mb.Revolute(at=(1.0, 0.0, 0.0)), **mb.rod(mass=1.0, length=1.0))
    m.output("x", Distance(unit="m", item=tip))
    for _ in range(2):  # the mechanism is left as it is
        with pytest.raises(AssertionError, match="derivative of output 'x'"):
            check_element(m, states=2)
    assert len(m.outputs) == 1


def test_a_stop_is_skipped_where_it_is_reached() -> None:
    report = check_element(mb.JointStop(lower=-0.1, upper=0.1, stiffness=1e4, damping=0.1), states=4)
    assert report.passed


def test_what_is_no_element_is_refused() -> None:
    with pytest.raises(mb.UserError, match="allowed: an instance of a joint"):
        check_element(3.0)


def test_what_was_not_examined_or_is_no_number_has_not_passed() -> None:
    outcome = Outcome()
    assert not outcome.passed
    outcome.add(Deviation(0.0, 1.0, 1.0, "x", uncertainty=1.0))
    assert (outcome.examined, outcome.skipped, outcome.passed) == (0, 1, False)
    outcome.add(Deviation(0.0, 1.0, 1.0, "x"))
    assert outcome.passed
    outcome.add(Deviation(float("nan"), float("nan"), 1.0, "x"))
    outcome.add(Deviation(0.0, 1.0, 1.0, "x"))
    assert not outcome.passed


@pytest.mark.parametrize("options", [{"states": 0}, {"length": 0.0}, {"length": float("nan")}, {"states": 1.5}])
def test_arguments_that_are_not_allowed_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(mb.UserError, match=next(iter(options))):
        check_element(Right(), **options)
