"""Random mechanisms with friction, stops and events, against absolute coordinates integrated by SciPy.

The mechanisms here are a few with one or two joints whose errors do not grow; :mod:`campaign` runs hundreds, and
describes the references.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from .campaign import TOLERANCE, Truth, allowance, compare, simulate, solver_of
from .drawn import Drawn, draw
from .switching import BRISTLE, SET_VALUED
from .tree import finish

RTOL = 1e-8  # of the reference
SEEDS = (3, 5, 17, 25, 28, 29, 128)


@cache
def with_reference(seed: int) -> tuple[Drawn, Truth, int]:
    """Return a mechanism, its reference and the law of friction of the reference."""
    d = finish(draw(seed))
    law = BRISTLE if d.has_bristles else SET_VALUED
    return d, allowance(d, law, TOLERANCE[law], runs=0, rtol=RTOL), law


@pytest.mark.parametrize("seed", SEEDS)
def test_motion_and_events_of_a_random_mechanism(seed: int) -> None:
    d, truth, law = with_reference(seed)
    result = simulate(d, solver_of(d), TOLERANCE[law])
    ratio, text = compare(d, truth, result)
    assert ratio <= 1.0, text
    assert not result.failed
    assert not result.warning


def test_an_error_of_the_friction_of_a_thousandth_is_found() -> None:
    d, truth, law = with_reference(28)
    more = [replace(f, coulomb=1.001 * f.coulomb, static=1.001 * f.static) for f in d.frictions]
    ratio, _ = compare(d, truth, simulate(replace(d, frictions=more), solver_of(d), TOLERANCE[law]))
    assert ratio > 1.0
