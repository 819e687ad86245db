"""Narrow parts of tables over coordinates are not passed: forces against closed forms, and which parts are narrow."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.narrow_parts import narrow_parts, places_of

from .test_events import SMALL, Midpoint

WIDTH, PLACE, HEIGHT = 5e-3, 5.0, 250.0  # m, half of the width at the foot; m; N


def spike(scale: float = 1.0, **options: Any) -> mb.Table:
    """Return a force against the motion over the path of 10 m that is zero but for a spike of 1e-3 of it.

    ``scale`` multiplies lengths and velocities; the work is that of a mass of 1 kg.
    """
    x = np.array([0.0, PLACE - WIDTH, PLACE, PLACE + WIDTH, 10.0]) * scale
    return mb.Table(x, np.array([0.0, 0.0, -HEIGHT, 0.0, 0.0]) * scale, **({"kind": "linear"} | options))


def exact() -> float:
    """Velocity after the spike: the work is its area."""
    return float(np.sqrt(1.0 + 2.0 * HEIGHT * WIDTH))


def sled(scale: float = 1.0, **options: Any) -> mb.Mechanism:
    """Return a mass of 1 kg that moves with 1 m/s until the force of a spike pushes it."""
    m = mb.Mechanism()
    body = m.body("sled", m.ground, mb.Translational(axis="x", rate=scale, nominal=scale), mass=1.0)
    m.force("spike", mb.JointSpring(stiffness=spike(scale, **options)), body)
    m.output("rate", body.rate())
    return m


@pytest.mark.parametrize(("solver", "tolerance"), [*((solver, 1e-8) for solver in SMALL), (Midpoint, 1e-4)])
def test_a_spike_of_a_table_is_not_passed(solver: Any, tolerance: float) -> None:
    """Closed form: energy. The events that a table declares are not listed."""
    result = mb.simulate(sled(), 7.0, interval=7.0, solver=solver, tolerance=tolerance)
    assert result["rate"][-1] == pytest.approx(exact(), abs=20.0 * tolerance)
    assert not result.warning
    assert not result.events


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_the_size_of_a_spike_has_no_influence(scale: float) -> None:
    result = mb.simulate(sled(scale), 7.0, interval=7.0, solver="adams", tolerance=1e-8)
    assert result["rate"][-1] / scale == pytest.approx(exact(), abs=2e-7)


def test_springs_between_points_do_not_pass_their_spikes() -> None:
    """Closed form: energy; the free length is added to the abscissas of the table."""
    m = mb.Mechanism()
    body = m.body("sled", m.ground, mb.Translational(axis="x", rate=1.0, start=1.0, nominal=1.0), mass=1.0)
    m.force("spike", mb.Spring(stiffness=spike(), free=0.5), m.ground, body)
    m.output("rate", body.rate())
    result = mb.simulate(m, 7.0, interval=7.0, solver="adams", tolerance=1e-8)
    assert result["rate"][-1] == pytest.approx(exact(), abs=2e-7)


@pytest.mark.parametrize("kind", ["linear", "monotone"])
@pytest.mark.parametrize("distance", [2.0, 10.0])
def test_several_spikes_in_one_narrow_part_are_not_passed(kind: str, distance: float) -> None:
    """Closed form: energy. Six spikes, whose distances are multiples of their width, push or brake."""
    feet = PLACE + 2.0 * WIDTH * (1.0 + distance) * np.arange(6)
    x = np.concatenate(([0.0], np.ravel(feet[:, None] + WIDTH * np.array([-1.0, 0.0, 1.0])), [10.0]))
    heights = HEIGHT * np.array([0.3, 0.1, -0.15, 0.25, 0.05, 0.2])
    y = np.concatenate(([0.0], np.ravel(heights[:, None] * np.array([0.0, -1.0, 0.0])), [0.0]))
    m = mb.Mechanism()
    body = m.body("sled", m.ground, mb.Translational(axis="x", rate=1.0, nominal=1.0), mass=1.0)
    m.force("spikes", mb.JointSpring(stiffness=mb.Table(x, y, kind)), body)
    m.output("rate", body.rate())
    result = mb.simulate(m, 7.0, interval=7.0, solver="adams", tolerance=1e-8)
    work = WIDTH * heights.sum()  # of triangles; curves without slope at all points have the same integral
    assert result["rate"][-1] == pytest.approx(np.sqrt(1.0 + 2.0 * work), abs=1e-6)
    assert not result.warning


def test_cams_declare_events_at_their_bumps() -> None:
    """The solver restarts where the bump of 10 mm begins and ends on a path of 10 m."""
    x = np.array([0.0, 4.995, 4.9975, 5.0, 5.0025, 5.005, 10.0])
    law = mb.Table(x, [0.0, 0.0, 5e-4, 1e-3, 5e-4, 0.0, 0.0], "monotone")
    m = mb.Mechanism()
    driver = m.body("driver", m.ground, mb.Translational(axis="x", rate=1.0, nominal=1.0), mass=1.0)
    follower = m.body("follower", m.ground, mb.Translational(axis="y", nominal=1e-3), mass=1.0)
    m.couple("cam", mb.Cam(law), follower, driver)
    CompiledMechanism(m)
    assert [event.value for event in m.events] == [4.995, 5.005]
    assert all(event.restarts and not event.is_listed for event in m.events)


@pytest.mark.parametrize(
    ("x", "y", "options", "parts"),
    [
        ([0.0, 4.9, 5.0, 5.1, 10.0], [0, 0, 1, 0, 0], {}, [(4.9, 5.1)]),
        ([0.0, 4.5, 5.0, 5.5, 10.0], [0, 0, 1, 0, 1], {}, []),  # wide
        ([0.0, 4.5, 5.0, 5.5, 10.0], [0, 0, 1, 0, 0], {}, [(4.5, 5.5)]),  # no force beyond it
        ([4.9, 5.0, 5.1], [0, 1, 0], {"beyond": "hold"}, [(4.9, 5.1)]),  # no force beyond it
        ([4.9, 5.0, 5.1], [0, 1, 2], {"beyond": "hold"}, []),  # two levels
        ([-1.0, 0.0, 0.5, 1.0], [-40.0, 0.0, 1.0, 30.0], {}, []),  # an ordinary spring
        ([-1e-3, -1e-4, 1e-4, 1e-3], [-90.0, 0.0, 0.0, 90.0], {}, []),  # backlash
        (np.linspace(0, 1, 201), np.sin(9 * np.linspace(0, 1, 201)), {"kind": "spline"}, []),
        (np.linspace(0, 1, 201), np.eye(201)[70], {}, [(0.345, 0.355)]),
        ([0.0, 1.0, 1.01, 3.0, 3.01, 5.0], [0, 0, 1, 1, 0, 0], {}, [(1.0, 1.01), (1.0, 3.01), (3.0, 3.01)]),
        ([0.0, 1.0, 2.0], [0, 1, 0], {"beyond": "periodic"}, []),
        ([0.0, 1.0], [0.0, 3.0], {}, []),
        ([0.0, 1.0], [3.0, 3.0], {"beyond": "hold"}, []),
    ],
)
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_narrow_parts(x: Any, y: Any, options: Any, parts: Any, scale: float) -> None:
    """Parts between corners that are much nearer to each other than to others, at any size."""
    given = {"kind": "linear"} | options
    table = mb.Table(scale * np.asarray(x, float), np.asarray(y, float) / scale, **given)
    np.testing.assert_allclose(np.reshape(narrow_parts(table), (-1, 2)), scale * np.reshape(parts, (-1, 2)), rtol=1e-12)
    assert set(np.ravel(narrow_parts(table))) <= set(places_of(table))


def test_corners_of_lines_within_narrow_parts_are_places_too() -> None:
    assert places_of(spike()) == [4.995, 5.0, 5.005]
    assert places_of(spike(kind="monotone")) == [4.995, 5.005]


def test_places_within_narrow_parts_are_limited_and_follow_the_curve() -> None:
    """A smooth bump of many points needs no places inside; a curve of noise has as many as allowed."""
    x = np.linspace(4.95, 5.05, 301)
    inside = (x - 4.95) * (5.05 - x)
    bump = mb.Table(np.append([0.0], x), np.append([0.0], inside), "monotone", "hold")
    noise = mb.Table(
        np.append([0.0], x), np.append([0.0], inside * np.random.default_rng(1).normal(size=301)), "linear"
    )
    assert len(places_of(bump)) < 5
    assert len(places_of(noise)) == 60


def test_a_table_that_is_none_is_refused_with_the_name_of_its_force() -> None:
    m = mb.Mechanism()
    body = m.body("sled", m.ground, mb.Translational(axis="x", nominal=1.0), mass=1.0)
    m.force("spike", mb.JointSpring(stiffness=mb.Table([0.0, 1.0], [1.0, 2.0, 3.0])), body)
    with pytest.raises(mb.UserError, match=r"the table of force 'spike' has \(2,\) and \(3,\) numbers"):
        CompiledMechanism(m)


def test_other_tables_declare_no_events() -> None:
    """They cost nothing."""
    m = mb.Mechanism()
    body = m.body("sled", m.ground, mb.Translational(axis="x", nominal=1.0), mass=1.0)
    m.force("spring", mb.JointSpring(stiffness=mb.Table([-1.0, 0.0, 0.5, 1.0], [-40.0, 0.0, 1.0, 30.0])), body)
    CompiledMechanism(m)
    assert not m.events
