"""Static friction of sheets that is larger than friction of sliding: a stiff strip is a block."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mbfmu.mechanics import Mechanism, Polynomial, Spring, Translational
from mbfmu.sheets import Wall, add_contact
from mbfmu.util.errors import UserError

from .test_sheet_stick import (
    DEFLECTION,
    FRICTION,
    GRAVITY,
    LENGTH,
    SLIDES,
    WEIGHT,
    WIDTH,
    add_block,
    in_nip,
    on_table,
    run,
)

STATIC_RATIO, STRIBECK, CREEP = 1.5, 0.02, 5e-3  # velocities in m/s
SIZES = [0.01, 1.0, 100.0]  # of the block; times are in units of the square root


def static_law(size: float) -> dict[str, float]:
    """Friction of a block of this size."""
    rate = np.sqrt(size)
    return {"static": STATIC_RATIO * FRICTION, "stribeck": STRIBECK * rate, "creep": CREEP * rate}


@pytest.mark.parametrize("size", SIZES)
def test_a_block_rests_between_the_angles_of_sliding_and_of_static_friction(size: float) -> None:
    """At the deflection d F / (mu_s N), and without creep."""
    m = on_table(slope=np.arctan(1.3 * FRICTION), size=size, law=static_law(size))
    x = run(m, 600.0 * np.sqrt(size), 60.0 * np.sqrt(size), tolerance=1e-4)["x"] / size
    assert 0.8 * DEFLECTION < x[-1] - x[0] < DEFLECTION
    assert np.ptp(x[1:]) < 1e-6 * DEFLECTION


@pytest.mark.parametrize("size", SIZES)
def test_beyond_the_angle_of_static_friction_a_block_slides_with_that_of_sliding(size: float) -> None:
    """With the acceleration g (sin a - mu cos a) as soon as it is much faster than the velocity of Stribeck."""
    slope, rate = np.arctan(1.6 * FRICTION), np.sqrt(size)
    x = run(on_table(slope=slope, size=size, law=static_law(size)), 1.0 * rate, 0.25 * rate)["x"] / size
    a = GRAVITY * (np.sin(slope) - FRICTION * np.cos(slope))
    assert x[4] - 2.0 * x[3] + x[2] == pytest.approx(0.25**2 * a, rel=1e-4)


def on_belt(size: float, speed: float, frequency: float) -> Mechanism:
    """A block on a belt with this speed that a spring holds; its ``frequency`` without friction, rad/s."""
    m, rate, mass = Mechanism(), 1.0 / np.sqrt(size), WEIGHT / GRAVITY * size**3
    v = speed * size * rate
    belt = m.body("belt", m.ground, Translational(axis="x", drive=Polynomial((0.0, v))), mass=1.0)
    on_table(table=belt, mechanism=m, size=size, law=static_law(size), rate=(v, 0.0, 0.0, 0.0, 0.0, 0.0))
    free, stiffness = 0.5 * LENGTH * size, mass * (frequency * rate) ** 2
    spring = Spring(stiffness=stiffness, free=free, at_b=(-free, 0.0, 0.5 * WIDTH * size))
    m.force("spring", spring, m.meshes[0].node(0, 1), m.ground)
    return m


def period(times: Any, x: Any) -> float:
    """Time between the last two crossings of the middle of a motion that sticks there, where it is linear."""
    level = 0.5 * (x.max() + x[len(x) // 2 :].min())
    i = np.flatnonzero((x[:-1] < level) & (x[1:] >= level))[-2:]
    first, second = times[i] + (level - x[i]) / (x[i + 1] - x[i]) * (times[1] - times[0])
    return float(second - first)


def stick_slip(times: Any, speed: float, frequency: float, steps: int = 2000) -> Any:
    """Positions (m) of the block on the belt by Heun's method: an elastic, perfectly plastic bristle, and friction by
    the law of Stribeck.
    """
    h, x, v, z = (times[1] - times[0]) / steps, 0.0, speed, 0.0
    found = [x]

    def rate(x: float, slip: float, z: float) -> float:
        g = 1.0 + (STATIC_RATIO - 1.0) * float(np.exp(-((slip / STRIBECK) ** 2)))
        return -(frequency**2) * x - SLIDES * g * min(1.0, max(-1.0, z + slip / CREEP))

    for k in range(steps * (len(times) - 1)):
        a, s = rate(x, v - speed, z), v - speed
        w = v + h * a
        end = min(1.0, max(-1.0, z + 0.5 * h * (s + w - speed) / DEFLECTION))
        following = v + 0.5 * h * (a + rate(x + h * v, w - speed, end))
        x, v, z = x + 0.5 * h * (v + following), following, end
        if (k + 1) % steps == 0:
            found.append(x)
    return np.array(found)


@pytest.mark.parametrize(("size", "solver"), [(0.01, "esdirk"), (1.0, "esdirk"), (100.0, "esdirk"), (1.0, "radau")])
def test_a_block_on_a_belt_sticks_and_slips(size: float, solver: str) -> None:
    """The motion, and its period: by integration, and of exact stick with a drop of the friction to that of sliding."""
    speed, frequency, t = 0.05, 6.0, 0.05 * np.arange(121)
    found = run(on_belt(size, speed, frequency), 6.0 * np.sqrt(size), 0.05 * np.sqrt(size), solver)
    x, expected = (found["x"] - found["x"][0]) / size, stick_slip(t, speed, frequency)
    np.testing.assert_allclose(x, expected, atol=2e-3 * np.ptp(expected))
    assert period(t, x) == pytest.approx(period(t, expected), rel=1e-3)
    drop = (STATIC_RATIO - 1.0) * SLIDES / frequency**2
    exact = 2.0 * drop / speed + 2.0 / frequency * (np.pi - np.arctan(drop * frequency / speed))
    assert exact < period(t, x) < 1.08 * exact  # slower, as the friction does not drop at once


def test_a_nip_at_rest_holds_more_than_it_resists_in_sliding() -> None:
    """A sheet rests under 1.3 mu N, and under 1.6 mu N is pulled out with (F - mu N) / m."""
    law = {"static": 0.75, "stribeck": STRIBECK, "least": CREEP}  # friction is 0.5, and mu N is 1 N
    way = run(in_nip(1.3, **law)[0], 600.0, 60.0, tolerance=1e-6)["x"]
    assert 0.8 * DEFLECTION < way[-1] - way[0] < DEFLECTION
    assert np.ptp(way[1:]) < 1e-6 * DEFLECTION
    x = run(in_nip(1.6, **law)[0], 0.05, 0.01)["x"]
    assert x[5] - 2.0 * x[4] + x[3] == pytest.approx(0.01**2 * 0.6 / (WEIGHT / GRAVITY), rel=1e-3)


@pytest.mark.parametrize(
    ("law", "message"),
    [
        ({"static": 0.2, "stribeck": 0.01}, "static of contact 'table' is 0.2; allowed: at least"),
        ({"static": 0.4}, "stribeck of contact 'table' is not given"),
        ({"static": 0.4, "stribeck": 0.0}, "stribeck of contact 'table' is 0.0"),
        ({"static": np.nan, "stribeck": 0.01}, "static of contact 'table' is nan"),
        ({"static": 0.4, "stribeck": 0.01, "deflection": None}, "without a deflection"),
        ({"static": 0.4, "stribeck": 0.01, "friction": 0.0}, "without friction of sliding"),
    ],
)
def test_static_friction_that_is_none_is_refused(law: dict[str, Any], message: str) -> None:
    m = Mechanism()
    strip = add_block(m)
    with pytest.raises(UserError, match=message):
        add_contact(m, "table", strip, Wall(), **({"friction": 0.3, "deflection": 1e-5} | law))


def test_static_friction_of_a_nip_is_checked() -> None:
    with pytest.raises(UserError, match=r"^static of nip 'nip' is 0\.3; allowed: at least"):
        in_nip(0.5, static=0.3, stribeck=0.01)
    with pytest.raises(UserError, match=r"^idler_static of nip 'nip' is 0\.1; allowed: at least"):
        in_nip(0.5, idler_static=0.1, stribeck=0.01)
