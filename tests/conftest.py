"""Hypothesis profiles and a fixture for FMUs built once a session."""

from __future__ import annotations

import gc
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from mbfmu.modeling import Model
    from mbfmu.native.parameters import SettableParameters

# One thread of BLAS for every process of the tests, set before numpy is imported: further threads of several processes
# occupy the processors while they wait for each other. What `.ci/run` does after the tests has the default number.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# The same examples in every run: a new failure means changed code. ``--hypothesis-profile=search`` looks for new ones.
settings.register_profile("same", max_examples=20, derandomize=True, deadline=None)
settings.register_profile("search", max_examples=500, deadline=None)
settings.load_profile("same")


LONG_TESTS = frozenset(Path(__file__).with_name("long_tests.txt").read_text().splitlines())


@pytest.hookimpl(tryfirst=True)  # before tests are selected by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of long_tests.txt."""
    for item in items:
        if item.nodeid.removeprefix("tests/") in LONG_TESTS:
            item.add_marker(pytest.mark.campaign)


def pytest_collection_finish() -> None:
    """Let later collections of garbage pass by the thousands of tests and modules, which stay to the end."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def fourbar_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The four-bar as an FMU whose default solver is adams."""
    from fmus.fourbar import FourBar
    from mbfmu.fmi import export
    from mbfmu.session.simulation import Settings

    return export(FourBar(), tmp_path_factory.mktemp("fmu") / "fourbar.fmu", Settings(solver="adams"), native=False)


@pytest.fixture(autouse=True, scope="session")
def _search_parameters_once() -> Iterator[None]:
    """Find the settable parameters of an included model once: tests export these models many times.

    A search builds a model some hundred times. Tests of the search call it themselves.
    """
    from mbfmu.native import data

    search, found = data.find_settable, {}

    def find_once(model: Model) -> SettableParameters:
        if not type(model).__module__.startswith("fmus."):
            return search(model)
        key = type(model).build, repr(model)
        if key not in found:
            found[key] = search(model)
        return found[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(data, "find_settable", find_once)
        yield


@pytest.fixture(autouse=True)
def _close_figures() -> Iterator[None]:
    """Close the figures of a test: pyplot keeps them, and warns of many."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.fixture(autouse=True)
def _forget_starts() -> None:
    """Let no test use what an earlier one has kept: tests replace parts of the analysis of starts."""
    if "mbfmu.session.kept_starts" in sys.modules:
        sys.modules["mbfmu.session.kept_starts"]._kept.clear()


@pytest.fixture
def command(capfd: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """Run the command line in this process: returns exit code, stdout, stderr without what depends on the cache."""
    from mbfmu.cli import main

    def run(*arguments: str) -> tuple[int, str, str]:
        code = main(arguments)
        out, err = capfd.readouterr()
        return code, out, re.sub(r"^compil(ing; this takes|ed in) .*\n", "", err, flags=re.MULTILINE)

    return run
