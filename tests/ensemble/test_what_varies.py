"""What varies from run to run: lists, ranges, distributions, sizes with tolerances, and the points they make."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from mbfmu.ensemble.design import Sampling, correlations, points
from mbfmu.ensemble.variation import Drawn, Listed, Variation, read_variation
from mbfmu.util.errors import UserError


def drawn(given: object, unit: str = "m") -> Drawn:
    own = read_variation("x", given, unit)
    assert isinstance(own, Drawn)
    return own


def test_lists_and_ranges():
    assert read_variation("x", [1, 2.5], "m") == Listed((1, 2.5))
    assert read_variation("x", {"values": ["adams", "radau"]}, "1") == Listed(("adams", "radau"))
    assert read_variation("x", np.array([1.0, 2.0]), "m") == Listed((1.0, 2.0))
    assert read_variation("x", {"from": 0.0, "to": 1.0, "count": 5}, "m") == Listed((0.0, 0.25, 0.5, 0.75, 1.0))
    ratios = read_variation("x", {"from": 1.0, "to": 100.0, "count": 3, "log": True}, "m")
    assert isinstance(ratios, Listed)
    assert ratios.values == pytest.approx((1.0, 10.0, 100.0))


@pytest.mark.parametrize(
    ("text", "center", "far"),
    [
        ("1 m +- 0.01 mm", 1.0, 1e-5), ("250 mm +- 5 mm", 0.25, 5e-3), ("2 +- 0.1", 2.0, 0.1), ("2.0+-5 %", 2.0, 0.1),
        ("1e-3 ± 1e-4 m", 1e-3, 1e-4), ("-0.5 m +/- 1 %", -0.5, 5e-3),
    ],
)  # fmt: skip
def test_a_size_with_its_tolerance_is_normal_and_ends_there(text: str, center: float, far: float):
    own = drawn(text)
    ends = own.at(np.array([1e-12, 0.5, 1.0 - 1e-12]))
    assert ends == pytest.approx([center - far, center, center + far], rel=1e-6, abs=1e-9 * far)
    within = stats.norm.cdf(1.0) - stats.norm.cdf(-1.0)
    u = own.distribution.cdf(center + far / 3.0) - own.distribution.cdf(center - far / 3.0)
    assert u == pytest.approx(within / (stats.norm.cdf(3.0) - stats.norm.cdf(-3.0)), rel=1e-9)


def test_degrees_are_radians_inside():
    assert drawn("10 deg +- 1 deg", "rad").at(np.array([0.5])) == pytest.approx(np.radians(10.0))


def test_distributions_are_those_of_scipy():
    own = drawn({"distribution": "lognorm", "s": 0.2, "scale": 3.0})
    assert own.at(np.array([0.1, 0.9])) == pytest.approx(stats.lognorm(0.2, scale=3.0).ppf([0.1, 0.9]))
    assert drawn({"from": 2.0, "to": 4.0}).at(np.array([0.25])) == pytest.approx(2.5)
    assert drawn({"from": 1.0, "to": 100.0, "log": True}).at(np.array([0.5])) == pytest.approx(10.0)
    assert drawn(stats.norm(1.0, 2.0)).at(np.array([0.5])) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ([], "at least one value"),
        ([1.0, np.nan], "finite"),
        ([None], "None"),
        (3.0, "allowed: a list"),
        ("wide", "a size and its tolerance"),
        ("1 m +- 0 mm", "greater than zero"),
        ("1 m +- 1 kg", "'kg'"),
        ("1 parsec +- 1 m", "parsec"),
        ({"from": 1.0, "to": 1.0}, "to a larger number"),
        ({"from": -1.0, "to": 1.0, "log": True}, "greater than zero"),
        ({"from": 0.0, "to": 1.0, "count": 1}, "count is 1"),
        ({"from": 0.0, "to": 1.0, "count": 2.0}, "count is 2.0"),
        ({"from": 0.0, "two": 1.0}, "'two'"),
        ({"from": "a", "to": 1.0}, "'a'"),
        ({"distribution": "normal", "loc": 0.0}, "did you mean"),
        ({"distribution": "norm", "mean": 0.0}, "does not take"),
        ({"distribution": "norm", "scale": -1.0}, "not defined"),
        ({"distribution": 3}, "no distribution 3"),
        ({"distribution": "rv_continuous"}, "no distribution 'rv_continuous'"),
        ({"from": 1.0, "to": 2.0, "log": "yes"}, "log is 'yes'"),
    ],
)
def test_what_is_no_variation_is_reported(given: object, told: str):
    with pytest.raises(UserError, match="'x'") as error:
        read_variation("x", given, "m")
    assert told in str(error.value)


TWO: dict[str, Variation] = {"a": Listed((1.0, 2.0)), "b": Listed(("u", "v", "w"))}
NORMAL: dict[str, Variation] = {name: Drawn(stats.norm(1.0, k)) for k, name in enumerate("xyz", 1)}


def test_lists_make_all_combinations_or_go_together():
    assert [tuple(p.values()) for p in points(TWO, Sampling())] == [(a, b) for a in (1.0, 2.0) for b in "uvw"]
    pair: dict[str, Variation] = {"a": Listed((1.0, 2.0)), "b": Listed(("u", "v"))}
    assert points(pair, Sampling(together=True)) == [{"a": 1.0, "b": "u"}, {"a": 2.0, "b": "v"}]
    with pytest.raises(UserError, match="'a' has 2, 'b' has 3"):
        points(TWO, Sampling(together=True))


def test_samples_are_alike_at_every_point_of_the_grid():
    found = points({"a": Listed((1.0, 2.0)), **NORMAL}, Sampling(count=7))
    assert len(found) == 14
    assert [p["x"] for p in found[:7]] == [p["x"] for p in found[7:]]
    assert found == points({"a": Listed((1.0, 2.0)), **NORMAL}, Sampling(count=7))
    assert found != points({"a": Listed((1.0, 2.0)), **NORMAL}, Sampling(count=7, seed=2))


@pytest.mark.parametrize("method", ["random", "latin", "sobol"])
def test_samples_have_their_distribution(method: str):
    found = points(NORMAL, Sampling(count=1024, method=method))
    for k, name in enumerate("xyz", 1):
        told = stats.kstest([p[name] for p in found], stats.norm(1.0, k).cdf)
        assert told.pvalue > 1e-3
    if method == "latin":  # one in each slice
        slices = np.floor(1024 * stats.norm(1.0, 1.0).cdf([p["x"] for p in found])).astype(int)
        assert sorted(slices) == list(range(1024))


@pytest.mark.parametrize("entry", [["x", "y", 0.8], {"of": ["x", "y"], "covariance": 1.6}])
def test_pairs_are_correlated(entry: object):
    told = correlations([entry], NORMAL)
    assert told == (("x", "y", pytest.approx(0.8)),)
    found = points(NORMAL, Sampling(count=4000, correlated=told))
    matrix = np.corrcoef([[p[name] for p in found] for name in "xyz"])
    assert matrix == pytest.approx(np.array([[1.0, 0.8, 0.0], [0.8, 1.0, 0.0], [0.0, 0.0, 1.0]]), abs=0.05)


def test_discrete_distributions_give_whole_numbers():
    found = points({"n": drawn({"distribution": "poisson", "mu": 3.0}, "1")}, Sampling(count=50))
    assert {type(p["n"]) for p in found} == {int}


def test_odd_correlations_are_reported():
    for entry, told in (
        (["x", "y", 1.0], "between -1 and 1"), (["x", "x", 0.5], "two names"), (["x", 0.5], "such as"),
        ({"of": ["x", "q"], "covariance": 1.0}, "has a distribution"), ({"of": 3, "covariance": 1.0}, "such as"),
        ({"of": ["x", "y"], "covariance": "x"}, "between -1 and 1"),
    ):  # fmt: skip
        with pytest.raises(UserError, match=told):
            correlations([entry], NORMAL)
    with pytest.raises(UserError, match="another correlation"):
        correlations([["x", "y", 0.5], ["y", "x", -0.5]], NORMAL)
    with pytest.raises(UserError, match="independent"):
        points(NORMAL, Sampling(method="tornado", correlated=(("x", "y", 0.5),)))
    both = (("x", "y", 0.9), ("y", "z", 0.9), ("x", "z", -0.9))
    with pytest.raises(UserError, match="contradict"):
        points(NORMAL, Sampling(correlated=both))
    with pytest.raises(UserError, match="no distribution"):
        points(NORMAL, Sampling(correlated=(("x", "q", 0.5),)))


def test_a_tornado_moves_one_at_a_time():
    vary: dict[str, Variation] = {"x": Drawn(stats.uniform(0.0, 1.0)), "y": Listed((5.0, 3.0, 4.0))}
    found = points(vary, Sampling(method="tornado"))
    assert found[0] == {"x": 0.5}
    assert [p["x"] for p in found[1:3]] == pytest.approx([0.05, 0.95])
    assert found[3:] == [{"x": 0.5, "y": 3.0}, {"x": 0.5, "y": 5.0}]


def test_sensitivity_mixes_two_samples():
    found = points(NORMAL, Sampling(method="sensitivity", count=8))
    rows = np.array([list(p.values()) for p in found]).reshape(5, 8, 3)
    for k in range(3):
        mixed = rows[2 + k]
        assert np.array_equal(mixed[:, k], rows[1][:, k])
        others = [i for i in range(3) if i != k]
        assert np.array_equal(mixed[:, others], rows[0][:, others])


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"count": 0}, "count is 0"), ({"count": 2.5}, "2.5"), ({"seed": -1}, "seed is -1"),
        ({"method": "halton"}, "halton"),
        ({"method": "sensitivity", "count": 100}, "powers of two"), ({"together": 1}, "true or false"),
    ],
)  # fmt: skip
def test_odd_samplings_are_reported(given: dict[str, object], told: str):
    with pytest.raises(UserError, match=told):
        Sampling(**given)  # type: ignore[arg-type]


def test_what_a_method_needs_is_reported():
    with pytest.raises(UserError, match="'a' is a list"):
        points({"a": Listed((1.0,)), **NORMAL}, Sampling(method="sensitivity", count=4))
    with pytest.raises(UserError, match="more than"):
        points({name: Listed(tuple(range(1000))) for name in "abc"}, Sampling())
