"""Errors of ``ida`` on sheets, and what runs report of them; motions by SciPy from the accelerations of the tree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb
from fmus.sheet import Sheet
from solvers import Options, stepper
from solvers.compiled.kernel import COMPILED
from solvers.projection.saddle import Accelerations

pytestmark = pytest.mark.skipif(not COMPILED, reason="takes minutes without a compiler")

SILENT = 100.0  # tolerances that an error may be without a remark
END = 0.03  # s
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-6, 1e-8)


@pytest.fixture(scope="module", params=[(7, 5, 0.0), (7, 5, 2e-4)], ids=str)
def motion(request: pytest.FixtureRequest) -> tuple[Any, Any]:
    """A clamped sheet with these nodes and damping time (s), and its positions at the end, by DOP853."""
    nx, nz, damping = request.param
    compiled = Sheet(nx=nx, nz=nz, damping=damping).compile()
    system, (q, v) = compiled.system, compiled.assemble()
    accelerations = Accelerations(system)

    def right(t: float, y: Any) -> Any:
        accelerations.solve(t, y[: system.nq], y[system.nq :])
        return np.concatenate((accelerations.qdot, accelerations.a))

    found = solve_ivp(right, (0.0, END), np.concatenate((q, v)), method="DOP853", rtol=1e-10, atol=1e-12)
    assert found.success
    return compiled, found.y[: system.nq, -1]


@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_an_error_of_a_hundred_tolerances_on_a_sheet_is_reported(motion: tuple[Any, Any], tolerance: float) -> None:
    compiled, exact = motion
    system = compiled.system
    run = stepper("ida", system, 0.0, *compiled.assemble(), Options(rtol=tolerance))
    assert run.advance(END).ok
    error = float(np.max(np.abs(run.q - exact) / system.position_sizes(system.size))) / tolerance
    assert error <= SILENT or "orders 1 and 2" in str(run.diagnostics), error


def test_the_warning_depends_on_the_sheet_and_names_a_remedy() -> None:
    """Coarse tolerances of small sheets are silent, and so are orders that were requested."""

    def remarks(tolerance: float, **settings: Any) -> str:
        run = mb.simulate(Sheet(nx=7, nz=5), 1e-4, interval=1e-4, tolerance=tolerance, **settings)
        return " ".join(map(str, run.diagnostics))

    assert "about 200 times the tolerance of 1e-06" in remarks(1e-6, solver="ida")
    assert "use 'esdirk'" in remarks(1e-6, solver="ida")
    assert "at a tolerance of 4e-10" in remarks(1e-6, solver="ida")
    assert "orders 1 and 2" not in remarks(1e-3, solver="ida")
    assert "[limited-order]" not in remarks(1e-6, solver="ida", max_order=5)
    assert "orders 1 and 2" not in remarks(1e-6, solver="esdirk")
