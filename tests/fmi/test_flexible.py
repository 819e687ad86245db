"""The four-bar with an elastic coupler as an FMU."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from agreement import check_against_direct, check_continuation

from fmus.fourbar import FourBar
from mbfmu.fmi import Fmu, export
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings

TIMES = np.linspace(0.0, 0.5, 26)
MODEL = FourBar(coupler_modes=2, coupler_damping=5.8115e-4)


@pytest.fixture(scope="module")
def flexible_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two modes, damped."""
    return export(MODEL, tmp_path_factory.mktemp("fmu") / "flexible.fmu", Settings(solver="adams"), native=False)


@pytest.mark.parametrize("solver", ["ida", "adams", "hybrid"])
def test_equals_the_direct_run(flexible_fmu: Path, solver: str) -> None:
    check_against_direct(flexible_fmu, MODEL, solver, TIMES)


def test_a_second_instance_continues_bit_for_bit(flexible_fmu: Path) -> None:
    with Fmu(flexible_fmu) as first, Fmu(flexible_fmu) as second:
        check_continuation(first, second, before=20, after=30)


def test_its_variables_have_units_and_meaning(flexible_fmu: Path) -> None:
    with Fmu(flexible_fmu) as fmu:
        assert fmu.variables["coupler.mode[2].amplitude"].unit == "m"
        assert fmu.variables["coupler.mode[1].acceleration"].unit == "m/s2"
        assert fmu.variables["coupler.deflection"].unit == "m"
        assert fmu.variables["coupler.bending_moment"].unit == "N.m"
        assert fmu.variables["coupler_modes"].variability == "constant"
        assert fmu.variables["youngs_modulus"].unit == "Pa"


def test_parameters_of_the_beam_act_at_the_end_of_initialization(flexible_fmu: Path) -> None:
    stiff = FourBar(coupler_modes=2, coupler_damping=5.8115e-4, youngs_modulus=4 * 117e9)
    direct = run(stiff, Settings(solver="adams", tolerance=1e-8), TIMES)
    with Fmu(flexible_fmu, {"youngs_modulus": 4 * 117e9, "tolerance": 1e-8}) as fmu:
        fmu.step_to(0.5)
        assert fmu["coupler.deflection"] == pytest.approx(direct["coupler.deflection"][-1], abs=1e-7)
