"""Finite-element modes of a beam against closed forms and against quadrature of the shapes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from mbfmu.mechanics import MODES, Beam
from mbfmu.mechanics.flexible.records import FlexibleRecord, NodeRecord
from mbfmu.util.errors import UserError

L, MASS, EI = 3.0, 24.057, 7897.5
SCALE = np.sqrt(EI / (MASS / L)) / L**2  # frequency is its product with the square of the eigenvalue beta L

EIGENVALUES = {  # beta L of the characteristic equations
    ("pinned", "pinned"): np.pi * np.arange(1, 4),
    ("clamped", "free"): [brentq(lambda x: np.cos(x) * np.cosh(x) + 1.0, a, a + 2.0) for a in (1.0, 4.0, 7.0)],
    ("clamped", "clamped"): [brentq(lambda x: np.cos(x) * np.cosh(x) - 1.0, a, a + 2.0) for a in (4.0, 7.0, 10.0)],
    ("free", "free"): [brentq(lambda x: np.cos(x) * np.cosh(x) - 1.0, a, a + 2.0) for a in (4.0, 7.0, 10.0)],
    ("clamped", "pinned"): [brentq(lambda x: np.tan(x) - np.tanh(x), a, a + 0.9) for a in (3.5, 6.5, 9.7)],
    ("guided", "pinned"): np.pi * (np.arange(3) + 0.5),
    ("guided", "guided"): np.pi * np.arange(1, 4),
    ("free", "guided"): [brentq(lambda x: np.tan(x) + np.tanh(x), a, a + 1.0) for a in (2.0, 5.0, 8.0)],
}


def beam(**changes: object) -> Beam:
    """The coupler of the flexible four-bar, but for these."""
    values: dict[str, object] = {"length": L, "mass": MASS, "bending_stiffness": EI, "modes": 3}
    return Beam(**(values | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(("ends", "eigenvalues"), EIGENVALUES.items())
def test_frequencies_converge_at_fourth_order(ends: tuple[str, str], eigenvalues: list[float]) -> None:
    exact = SCALE * np.square(eigenvalues)
    errors = [np.abs(beam(elements=n, ends=ends).frequencies / exact - 1.0) for n in (12, 24)]
    assert errors[0].max() < 1e-3
    resolved = errors[1] > 1e-8  # roundoff of the eigenvalues is some 1e-9
    assert resolved.sum() >= 2
    np.testing.assert_allclose(np.log2(errors[0] / errors[1])[resolved], 4.0, atol=0.15)


@pytest.mark.parametrize(("ends", "eigenvalues"), EIGENVALUES.items())
def test_no_mode_is_lost_where_there_are_many_elements(ends: tuple[str, str], eigenvalues: list[float]) -> None:
    """The slowest is slower than the fastest by the square of their number and more."""
    for elements in (40, 70, 100):
        np.testing.assert_allclose(
            beam(elements=elements, ends=ends).frequencies, SCALE * np.square(eigenvalues), rtol=2e-5
        )


def test_modes_of_the_pinned_beam_are_sines() -> None:
    x = np.linspace(0.0, L, 50)
    for elements, bound in ((10, 4e-4), (20, 3e-5)):
        pinned = beam(elements=elements)
        for k in range(3):
            phi = np.array([pinned.shape(place)[0][k] for place in x])
            slope = np.array([pinned.shape(place)[1][k] for place in x])
            wave = (k + 1) * np.pi / L
            np.testing.assert_allclose(phi, np.sin(wave * x), atol=bound * (k + 1) ** 2)
            np.testing.assert_allclose(slope, wave * np.cos(wave * x), atol=20.0 * bound * (k + 1) ** 3)


def test_moments_are_of_the_order_of_the_shapes() -> None:
    errors = []
    for elements in (8, 16):
        moment = beam(elements=elements).moment(0.5 * L)[0]
        errors.append(abs(moment / (-EI * (np.pi / L) ** 2) - 1.0))
    assert errors[1] < 1e-5
    assert np.log2(errors[0] / errors[1]) > 3.8


def test_integrals_are_those_of_the_shapes() -> None:
    arm = beam(ends=("clamped", "free"), elements=5, modes=2, stiffening=True, damping=0.25)
    record = FlexibleRecord.zeros(1)[0]
    arm.fill(record)
    rho = MASS / L

    def integral(function: object) -> float:
        knots = np.linspace(0.0, L, 6)
        return float(sum(quad(function, a, b)[0] for a, b in pairwise(knots)))

    def shape(x: float, k: int) -> float:
        return float(arm.shape(x)[0][k])

    assert (record["mass"], record["X1"], record["X2"]) == pytest.approx((MASS, MASS * L / 2, MASS * L**2 / 3))
    assert (record["beta"], record["shortens"]) == (0.25, 2)
    for k in range(2):
        assert record["a"][k] == pytest.approx(integral(lambda x, k=k: rho * shape(x, k)))
        assert record["c"][k] == pytest.approx(integral(lambda x, k=k: rho * x * shape(x, k)))
        assert record["mu"][k] == pytest.approx(integral(lambda x, k=k: rho * shape(x, k) ** 2))
        assert record["kappa"][k] == pytest.approx(record["mu"][k] * arm.frequencies[k] ** 2)
    np.testing.assert_allclose(record["g0"][:2, :2], [
        [integral(lambda x, k=k, l=l: rho * arm.shortening(x)[k, l]) for l in range(2)] for k in range(2)
    ], rtol=1e-9)  # fmt: skip
    np.testing.assert_allclose(record["g1"][:2, :2], [
        [integral(lambda x, k=k, l=l: rho * x * arm.shortening(x)[k, l]) for l in range(2)] for k in range(2)
    ], rtol=1e-9)  # fmt: skip
    node = NodeRecord.zeros(1)[0]
    arm.fill_node(1.3, node)
    assert node["G"][0, 1] == pytest.approx(quad(lambda x: np.prod(arm.shape(x)[1]), 0.0, 1.3, points=[0.6, 1.2])[0])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"length": 0.0}, "length of a beam is 0.0"),
        ({"mass": -1.0}, "mass of a beam is -1.0"),
        ({"bending_stiffness": float("nan")}, "bending_stiffness of a beam is nan"),
        ({"damping": -1e-3}, "damping of a beam is -0.001"),
        ({"elements": 0}, "elements of a beam are 0; allowed: 1 to 100"),
        ({"elements": 101}, "elements of a beam are 101; allowed: 1 to 100"),
        ({"ends": ("pinned",)}, "ends of a beam are .*; allowed: two of pinned, clamped, guided, free"),
        ({"ends": None}, "ends of a beam are None; allowed: two of"),
        ({"stiffening": "yes"}, "stiffening of a beam is 'yes'; allowed: True, False"),
        ({"elements": 10.0}, "elements of a beam are 10.0; allowed: whole numbers"),
        ({"modes": 1.5}, "modes of a beam are 1.5; allowed: whole numbers"),
        ({"ends": ("pinned", "glued")}, "end of a beam is 'glued'; allowed: pinned, clamped, guided, free"),
        ({"modes": 0}, "modes of a beam are 0; allowed: 1 to 12"),
        ({"modes": MODES + 1}, "allowed: 1 to 12"),
        ({"modes": 3, "elements": 1}, "allowed: 1 to 2 with 1 elements between pinned and pinned ends"),
    ],
)
def test_what_is_no_beam_is_refused_by_name(changes: dict[str, object], said: str) -> None:
    with pytest.raises(UserError, match=said.replace("(", r"\(")):
        beam(**changes)


def test_places_off_the_beam_are_refused() -> None:
    with pytest.raises(UserError, match=r"place on a beam is 3.1 m; allowed: 0 to 3.0"):
        beam().shape(3.1)
