"""Machine code, built once, and models at work in it."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import pytest
from running import Running

from mbfmu.native.runtime import library
from mbfmu.native.targets import host
from mbfmu.simulation import Simulation


@pytest.fixture(scope="session")
def runtime() -> ctypes.CDLL:
    return ctypes.CDLL(str(library(host())))


@pytest.fixture
def running(runtime: ctypes.CDLL) -> Callable[[Simulation], Running]:
    return lambda simulation: Running(runtime, simulation)
