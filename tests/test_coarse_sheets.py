"""Sheets that bend too far for their grid: a warning reports it, and a folded sheet ends the run."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.sheet import Sheet
from mbfmu.fmi import export
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.steady.equilibrium import equilibrium


def test_a_coarse_grid_is_reported_and_a_fine_one_is_not() -> None:
    """0.1 mm on 7 x 5 nodes hangs 25 mm off."""
    thin = Sheet(nx=7, nz=5, thickness=0.1e-3)
    advice = r"rotated by up to (4|5)\d deg between nodes 'sheet.5.\d' and 'sheet.6.\d'.*Refine the grid .* \d\d x 5"
    result = run(thin, Settings(tolerance=1e-4), np.linspace(0.0, 0.2, 21))
    assert re.search(advice, result.warning)
    assert not result.failure
    found = equilibrium(thin)
    assert re.search(advice, found.warning)
    assert [d["text"] for d in found.as_dict()["diagnostics"]] == [d.text for d in found.diagnostics]
    assert equilibrium(Sheet(nx=7, nz=5)).warning == ""


@pytest.mark.campaign
def test_commands_report_a_coarse_grid(command: Any, tmp_path: Path) -> None:
    warning = equilibrium(Sheet(nx=7, nz=5, thickness=0.1e-3)).warning
    code, out, _ = command("equilibrium", "sheet", "--set=nx=7", "--set=nz=5", "--set=thickness=1e-4", "--others=0")
    assert code == 0
    assert f"warning: {warning}" in out
    assert equilibrium(Sheet()).warning == ""
    short = ("--stop-time=0.15", "--interval=0.01", "-o", str(tmp_path))
    _, _, err = command("run", "sheet", "--set=nx=7", "--set=nz=5", "--set=thickness=1e-4", *short)
    assert err.count("adjacent cells are rotated by up to") == 1
    assert "cells" not in command("run", "sheet", "--set=nx=13", "--set=nz=5", *short)[2]


def test_a_sheet_spun_until_it_folds_ends_with_a_message(capfd: Any) -> None:
    """Ten times its lowest frequency; SUNDIALS keeps its warnings to itself."""
    model = Sheet(nx=4, nz=3, support="free", start_spin=600.0)
    result = run(model, Settings(tolerance=1e-5), np.linspace(0.0, 0.05, 51))
    said = r"a cell is folded at t = 0.01\d* s: .* 'sheet.\d.\d' and 'sheet.\d.\d'; .* Move it"
    assert re.search(said, result.failure)
    assert 5e-3 < result.t[-1] < 0.02
    assert result.warning == ""
    assert "".join(capfd.readouterr()) == ""


def test_a_host_reads_the_warning_in_the_log(tmp_path: Path) -> None:
    from fmpy import simulate_fmu

    path = export(Sheet(nx=5, nz=4, thickness=0.05e-3), tmp_path / "sheet.fmu", Settings(tolerance=1e-4), native=False)
    told: list[str] = []
    simulate_fmu(
        str(path), stop_time=0.1, output_interval=0.01, debug_logging=True,
        logger=lambda _, name, status, category, text: told.append(text.decode()),
    )  # fmt: skip
    assert sum("Refine the grid of 'sheet'" in text for text in told) == 1


def test_the_warning_of_a_fold_is_part_of_the_saved_state() -> None:
    model = Sheet(nx=4, nz=3, support="free", start_spin=600.0)
    simulation = Simulation(model, Settings(tolerance=1e-5))
    flat = simulation.save()
    while not simulation.warning:
        assert simulation.advance(simulation.t + 1e-3).ok
    bent, said = simulation.save(), simulation.warning
    while not simulation.failure:
        simulation.advance(simulation.t + 1e-3)
    simulation.restore(bent)
    assert not simulation.failure
    assert simulation.warning == said
    simulation.restore(flat)
    assert not simulation.warning
    assert simulation.advance(1e-3).ok
