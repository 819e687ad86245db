"""What is measured of a run, against closed forms."""

from __future__ import annotations

from math import isnan, pi, sqrt
from typing import Any

import numpy as np
import pytest

from fmus.governor import Governor
from mbfmu import equilibrium
from mbfmu.ensemble.definition import define
from mbfmu.ensemble.measures import History, Own, Steady, read_measure, settling
from mbfmu.ensemble.sensitivity import sobol_indices, tornado
from mbfmu.ensemble.study import Study
from mbfmu.mechanics import Variable
from mbfmu.session.result import Result
from mbfmu.util.errors import UserError
from solvers import Statistics

T = np.linspace(0.0, 2.0 * pi, 4001)
WAVE = Result(T, np.column_stack([np.sin(T), np.exp(-T)]), (Variable("y", "m"), Variable("z", "m")), Statistics(), 0.0)


def measured(given: Any) -> float:
    own = read_measure("q", given, ("y", "z"), steady=True)
    assert isinstance(own, History)
    return own.of(WAVE)


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ("end z", np.exp(-2.0 * pi)), ("largest y", 1.0), ("least y", -1.0), ("range y", 2.0), ("mean y", 0.0),
        ("rms y", sqrt(0.5)), ("mean z", (1.0 - np.exp(-2.0 * pi)) / (2.0 * pi)),
        ({"take": "crossing", "output": "y", "threshold": 0.5}, pi / 6.0),
        ({"take": "crossing", "output": "y", "threshold": 0.5, "number": 2}, 5.0 * pi / 6.0),
        ({"take": "crossing", "output": "y", "threshold": 0.0, "direction": "down"}, pi),
        ({"take": "settling", "output": "z", "within": 0.1}, -np.log(0.1 + np.exp(-2.0 * pi))),
        ({"take": "settling", "output": "z"}, -np.log(0.02 * (1.0 - np.exp(-2.0 * pi)) + np.exp(-2.0 * pi))),
    ],
)  # fmt: skip
def test_histories_have_closed_forms(given: Any, wanted: float):
    assert measured(given) == pytest.approx(wanted, abs=2e-3 if "settling" in str(given) else 1e-6)


def test_what_is_no_number_settles_never():
    assert isnan(settling(np.arange(3.0), np.array([0.0, np.nan, 1.0])))


def test_what_is_never_crossed_is_no_number():
    assert isnan(measured({"take": "crossing", "output": "y", "threshold": 2.0}))
    assert isnan(measured({"take": "crossing", "output": "y", "threshold": 0.5, "number": 3}))


def test_steady_states_are_measured():
    state = equilibrium(Governor())
    assert Steady("h", "equilibrium", "collar.height").of(state) == state.outputs["collar.height"]
    own = read_measure("f", "frequency 1", (), steady=True)
    assert isinstance(own, Steady)
    slowest = min(mode.frequency for mode in state.modes if mode.frequency > 0.0)
    assert own.of(state) == pytest.approx(slowest / (2.0 * pi))
    assert isnan(Steady("f", "frequency", mode=99).of(state))


def test_functions_of_the_user_give_numbers():
    assert Own("own", lambda r: r["y"].max(), "").of(WAVE) == pytest.approx(1.0)
    assert Own("own", lambda r: np.array(3), "").of(WAVE) == 3.0
    with pytest.raises(UserError, match="'own' fails with ZeroDivisionError"):
        Own("own", lambda _: 1 / 0, "").of(WAVE)
    with pytest.raises(UserError, match="'own' returns None"):
        Own("own", lambda _: None, "").of(WAVE)  # type: ignore[arg-type, return-value]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("biggest y", "'biggest'"), ("largest w", "no output 'w'"), ("largest", "no output None"), (3, "is 3"),
        ({"take": "crossing", "output": "y"}, "without threshold"),
        ({"take": "crossing", "output": "y", "threshold": "high"}, "threshold is 'high'"),
        ({"take": "crossing", "output": "y", "threshold": 0.0, "direction": "left"}, "any, up, down"),
        ({"take": "crossing", "output": "y", "threshold": 0.0, "number": 0}, "from 1 on"),
        ({"take": "largest", "output": "y", "threshold": 0.0}, "'threshold'"),
        ({"take": "settling", "output": "y", "within": -1.0}, "at least 0"),
        ("frequency 0", "from 1 on"), ("frequency x", "'x'"),
    ],
)  # fmt: skip
def test_what_is_no_measure_is_reported(given: Any, told: str):
    with pytest.raises(UserError, match="'q'") as error:
        read_measure("q", given, ("y", "z"), steady=True)
    assert told in str(error.value)
    with pytest.raises(UserError, match="no steady states"):
        read_measure("q", "frequency 1", ("y",), steady=False)


def made(varied: tuple[str, ...], values: np.ndarray) -> Study:
    rows = tuple({"y": float(v), "seconds": 0.0, "status": "ok"} for v in values)
    from pathlib import Path

    return Study("made", rows, {}, varied, ("y",), Path())


def test_indices_of_ishigamis_function():
    from scipy import stats

    from mbfmu.ensemble.design import Sampling, points
    from mbfmu.ensemble.variation import Drawn

    names, n = ("a", "b", "c"), 4096
    vary = {name: Drawn(stats.uniform(-pi, 2.0 * pi)) for name in names}
    x = np.array([list(p.values()) for p in points(vary, Sampling(method="sensitivity", count=n))]).T
    y = np.sin(x[0]) + 7.0 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])
    own = sobol_indices(made(names, y), "y", n)
    v1, v2, v13 = 0.5 * (1.0 + 0.1 * pi**4 / 5.0) ** 2, 49.0 / 8.0, 0.01 * pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    whole = v1 + v2 + v13
    assert own.first == pytest.approx([v1 / whole, v2 / whole, 0.0], abs=0.02)
    assert own.total == pytest.approx([(v1 + v13) / whole, v2 / whole, v13 / whole], abs=0.02)
    assert np.all(own.first_error < 0.1)


def test_a_tornado_has_its_longest_bar_first():
    own = tornado(made(("a", "b"), np.array([1.0, 0.9, 1.1, 0.0, 5.0])), "y")
    assert own.names == ("b", "a")
    assert own.middle == 1.0
    assert own.ends.tolist() == [[0.0, 5.0], [0.9, 1.1]]


def test_steady_states_have_inputs_as_they_start():
    with pytest.raises(
        UserError, match=r"measure 'f' is evaluated at the steady state, at which the input 'crank.torque'"
    ):
        define({"scene": "fourbar", "vary": {"crank.torque": [1.0, 2.0]}, "measure": {"f": "frequency 1"}})
