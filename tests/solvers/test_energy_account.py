"""Work summed next to the steps of another integrator."""

from __future__ import annotations

import numpy as np
import pytest

from solvers.compiled.kernel import records
from solvers.energy_account import ENERGY_ACCOUNT, POWER_POINTS, record_step, restart_work, work_at

Polynomial = np.polynomial.Polynomial


@pytest.mark.parametrize("degree", range(POWER_POINTS))
def test_powers_that_are_polynomials_are_integrated_exactly(degree: int) -> None:
    """Once as many steps are known as the polynomial needs; at uneven steps, in a step and where it ends."""
    rng = np.random.default_rng(degree)
    power = Polynomial(rng.normal(size=degree + 1))
    work, c, t = power.integ(), records(1, ENERGY_ACCOUNT), 0.0
    restart_work(c, 0.0)
    for k in range(POWER_POINTS + 6):
        record_step(c, t, power(t))
        if k == degree:  # what came before was of lower order
            before, at = c["work"][0], t
        if k > max(degree, 1):
            inside = c["power_times"][0, 1] + rng.uniform() * (t - c["power_times"][0, 1])
            assert c["work"][0] - before == pytest.approx(work(t) - work(at), rel=1e-9, abs=1e-9)
            assert work_at(c, inside) - before == pytest.approx(work(inside) - work(at), rel=1e-9, abs=1e-9)
        t += rng.uniform(0.05, 0.4)


def test_error_of_the_formula_is_in_the_bound() -> None:
    """If the power is not a polynomial, the error of the work is less than the part added to the bound of the energy
    error, and decreases with the step.
    """
    errors = []
    for step in (0.1, 0.05, 0.025):
        c = records(1, ENERGY_ACCOUNT)
        restart_work(c, 3.0)
        for t in np.arange(0.0, 4.0 + 0.5 * step, step):
            record_step(c, t, np.exp(np.sin(3.0 * t)))
        exact = 3.0 + np.trapezoid(np.exp(np.sin(3.0 * (x := np.linspace(0.0, 4.0, 2_000_001)))), x)
        assert abs(c["work"][0] - exact) <= c["energy_error_bound"][0]
        errors.append(abs(c["work"][0] - exact))
    assert errors[0] > 2.9 * errors[1] > 2.9**2 * errors[2]  # first steps know few points


def test_a_new_start_goes_on_from_the_work_done() -> None:
    c = records(1, ENERGY_ACCOUNT)
    restart_work(c, 0.0)
    for t in (0.0, 0.5, 1.0):
        record_step(c, t, 2.0)
    restart_work(c, c["work"][0])
    assert work_at(c, 1.0) == 2.0
    for t in (1.0, 1.25):
        record_step(c, t, -4.0)
    assert work_at(c, 1.25) == 1.0
    assert c["work_total_variation"][0] == 3.0
