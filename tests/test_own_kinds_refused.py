"""Kinds of a user's own with a mistake in them: a sentence that names the kind and what is missing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from mbfmu import Cam, Mechanism, Translational, UserError, simulate
from mbfmu.mechanics import Body, CutJoint, Force, Joint, Sensor, kernel

KEPT = np.dtype([("w", np.float64)])


@kernel
def nothing(item: Any, t: float, arrays: Any, state: Any) -> None:
    """A force that is none."""


@kernel
def too_few(item: Any, t: float, arrays: Any) -> None:
    """One argument less than it is called with."""


@kernel
def raising(item: Any, t: float, arrays: Any, state: Any) -> None:
    """Raises, in a callback that no exception leaves."""
    if t >= 0.0:
        raise ValueError("no")


@kernel
def no_field(item: Any, t: float, arrays: Any, state: Any) -> None:
    """Reads what its record has not."""
    state.Q[0] += item.nosuch


@kernel
def two(sensor: Any, lam: Any, arrays: Any, state: Any) -> Any:
    """Two numbers where one is wanted."""
    return 1.0, 2.0


def own(role: type, **said: Any) -> Any:
    """Return something of a kind of this role."""
    return dataclass(frozen=True, kw_only=True)(type("Own", (role,), said))


def odd_fill(self: Any, record: Any, site: Any) -> None:
    """Writes into what is not there."""
    record["q"] = 1.0


def force(**said: Any) -> Callable[[Mechanism, Body], Any]:
    return lambda m, b: m.force("f", own(Force, **said)(), b)


@pytest.mark.parametrize(
    ("add", "message"),
    [
        (force(apply=None), "force 'f' is of class Own, which has no kernel 'apply'"),
        (force(), "has no kernel 'apply'"),
        (force(apply=len), "decorate it with mbfmu.mechanics.kernel"),
        (force(apply=raising), "force 'f' is of class Own, whose kernel 'apply' raises"),
        (force(apply=too_few), "kernel 'apply' .*too_few.* cannot be compiled.*its record, time, arrays, state"),
        (force(apply=no_field), "cannot be compiled: .*nosuch"),
        (force(apply=nothing, drawn="rod"), "class Own, whose `drawn` is 'rod'; allowed: '', 'coil'"),
        (force(apply=nothing, record=3), "record is 3; allowed: a NumPy dtype"),
        (force(apply=nothing, record=np.dtype([])), "allowed: a NumPy dtype of named fields"),
        (force(apply=nothing, record=np.dtype([("x", np.float64, (0,))])), "one number or more"),
        (force(apply=nothing, record=np.dtype([("x", "U4")])), "float64 or int64"),
        (force(apply=nothing, record=KEPT, fill=odd_fill), "force 'f': fill of Own failed: ValueError"),
        (lambda m, b: m.body("c", b, own(Joint, place=nothing)(), mass=1.0), "does not say its 'nq'"),
        (lambda m, b: m.cut("c", own(CutJoint, evaluate=nothing)(), b, m.ground), "does not say its 'rows'"),
        (lambda m, b: m.output("s", own(Sensor, read=two)(unit="m")), "kernel 'read' .* cannot be compiled"),
    ],
)
def test_a_mistake_in_an_element_type_is_an_error_message(add: Callable[[Mechanism, Body], Any], message: str) -> None:
    def made_and_run() -> None:
        m = Mechanism()
        add(m, m.body("b", m.ground, Translational(), mass=1.0))
        simulate(m, 0.01, solver="adams")

    with pytest.raises(UserError, match=message):
        made_and_run()


def test_a_law_without_a_slope_where_it_starts_is_named() -> None:
    m = Mechanism()
    a, b = (m.body(name, m.ground, Translational(), mass=1.0) for name in "ab")
    m.couple("mesh", Cam("sqrt(q)", width=0.1), a, b)
    with pytest.raises(UserError, match="'mesh' or its derivative is not finite"):
        simulate(m, 0.01)


def test_a_watch_that_is_no_function_is_refused() -> None:
    m = Mechanism()
    m.body("b", m.ground, Translational(), mass=1.0)
    with pytest.raises(UserError, match="watch is 3"):
        simulate(m, 0.01, watch=3)  # type: ignore[arg-type]
