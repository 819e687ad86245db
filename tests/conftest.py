"""Hypothesis profiles and a fixture for FMUs built once a session."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

# The same examples in every run: a failure tells of a change. ``--hypothesis-profile=search`` looks for new ones.
settings.register_profile("same", max_examples=20, derandomize=True, deadline=None)
settings.register_profile("search", max_examples=500, deadline=None)
settings.load_profile("same")


# Tests of 10 to 60 s whose code other tests run with smaller models: marked ``campaign``.
LONG_TESTS = frozenset(
    """
    ensemble/test_study.py::test_a_study_that_is_killed_goes_on_where_it_was[2]
    ensemble/test_study.py::test_a_separate_pool
    fmi/test_c_host.py::test_it_ends_well[feeder]
    fmi/test_c_host.py::test_it_ends_well[governor]
    fmi/test_c_host.py::test_it_ends_well[pendulum]
    fmi/test_c_host.py::test_it_ends_well[sheet]
    loops/test_eliminated_esdirk.py::test_a_ladder_of_200_loops
    native/test_empty_models.py::test_machine_code_has_the_numbers_of_python[Silent-radau]
    native/test_implicit_tree_fmus.py::test_outputs_are_those_of_a_simulation[sheet, ida]
    native/test_implicit_tree_fmus.py::test_outputs_are_those_of_a_simulation[sheet in air, ida]
    native/test_parameters.py::test_entries_are_the_arrays_of_plants_built_with_other_values[sheet]
    native/test_parameters.py::test_which_parameters_of_shipped_models_stay_settable[sheet]
    native/test_running_scenes.py::test_an_export_without_a_compiler_has_the_bytes_and_the_messages_of_another_one
    test_auto.py::test_auto_takes_the_cheapest_family_and_reports_why[sheet]
    test_coarse_sheets.py::test_a_sheet_spun_until_it_folds_ends_with_a_message
    test_coarse_tolerances.py::test_errors_at_coarse_tolerances_are_reported_and_not_larger[top]
    test_couplings.py::test_a_large_tree_with_gears
    test_equilibrium_paths.py::test_a_compressed_plate_buckles_at_one_load_whatever_the_tree[clamped]
    test_equilibrium_paths.py::test_a_guided_column_buckles_at_the_loads_of_its_eigenvalues[110]
    test_equilibrium_paths.py::test_a_hinged_roof_snaps_through[0.00635-1000.0-0.1953]
    test_examples_robot_arm.py::test_torques_of_the_fmu_converge_with_the_step[1-1.0]
    test_stretched_sheet.py::test_a_sheared_film_wrinkles
    test_supported_sheet.py::test_motion_and_reactions_are_those_of_the_dense_way[guided]
    """.replace("\n    ", "\n")
    .strip()
    .splitlines()
)


@pytest.hookimpl(tryfirst=True)  # before tests are selected by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark LONG_TESTS."""
    for item in items:
        if item.nodeid.removeprefix("tests/") in LONG_TESTS:
            item.add_marker(pytest.mark.campaign)


@pytest.fixture(scope="session")
def fourbar_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The four-bar as an FMU whose default solver is adams."""
    from fmus.fourbar import FourBar
    from mbfmu.fmi import export
    from mbfmu.session.simulation import Settings

    return export(FourBar(), tmp_path_factory.mktemp("fmu") / "fourbar.fmu", Settings(solver="adams"), native=False)


@pytest.fixture(autouse=True)
def _close_figures() -> Iterator[None]:
    """Close the figures of a test: pyplot keeps them, and warns of many."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.fixture
def command(capfd: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """Run the command line in this process: returns exit code, stdout, stderr without what depends on the cache."""
    from mbfmu.cli import main

    def run(*arguments: str) -> tuple[int, str, str]:
        code = main(arguments)
        out, err = capfd.readouterr()
        return code, out, re.sub(r"^compil(ing; this takes|ed in) .*\n", "", err, flags=re.MULTILINE)

    return run
