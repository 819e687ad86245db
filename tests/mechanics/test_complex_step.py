"""The complex twin: on real numbers it is the mechanism itself, along i e it carries the exact derivative."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from random_mechanisms import COUPLINGS, CUTS, JOINTS, Case, build, cases

from mbfmu.mechanics import Revolute, Universal
from mbfmu.sheets import Geodesic
from solvers.system import Terms

E = 1e-30
H = 1e-3
STENCIL = {-3: -1 / 60, -2: 9 / 60, -1: -45 / 60, 1: 45 / 60, 2: -9 / 60, 3: 1 / 60}  # sixth order


def terms_at(case: Case, s: float, dq: Any, dv: Any) -> list[Any]:
    """Every term at the state moved by s along (dq, dv)."""
    system = case.compiled.system
    terms, q = system.allocate_terms(), case.q.copy()
    system.apply(q, s * dq)
    system.fill(case.t, q, case.v + s * dv, terms)
    return list(terms)


def check(case: Case) -> None:
    system, rng = case.compiled.complex_system(), np.random.default_rng(0)
    dq, dv = rng.normal(size=system.n), rng.normal(size=system.n)
    terms = Terms.allocate(system.nq, system.n, system.m, complex)
    q: Any = case.q.astype(complex)
    step: Any = 1j * E * dq
    system.apply(q, step)
    moved: Any = case.v + 1j * E * dv
    system.fill(case.t, q, moved, terms)
    values = terms_at(case, 0.0, dq, dv)
    slopes = [
        sum(weight * term for weight, term in zip(STENCIL.values(), column, strict=True)) / H
        for column in zip(*(terms_at(case, k * H, dq, dv) for k in STENCIL), strict=True)
    ]
    for name, term, value, slope in zip(Terms._fields, terms, values, slopes, strict=True):
        size = max(1.0, float(np.abs(value).max(initial=0.0)), float(np.abs(slope).max(initial=0.0)))
        np.testing.assert_allclose(term.real, value, rtol=0, atol=1e-13 * size, err_msg=name)
        np.testing.assert_allclose(term.imag / E, slope, rtol=0, atol=1e-9 * size, err_msg=name)


@given(cases(cuts=True, driven=True, forces=True))
def test_derivatives_on_random_mechanisms(case: Case) -> None:
    check(case)


@pytest.mark.parametrize("joint", JOINTS)
@pytest.mark.parametrize("cut", CUTS)
def test_derivatives_of_every_joint_and_cut(joint: Any, cut: Any) -> None:
    check(build(3, [Geodesic, joint, Geodesic], [cut], False, True))


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_derivatives_of_every_coupling(coupling: Any) -> None:
    for driven in (False, True):
        check(build(3, [Revolute, Universal, Geodesic], [coupling], driven, True))
