"""Models as FMUs, systems of FMUs, and a harness that drives an FMU."""

from .export import export
from .harness import Fmu
from .ssp import write_ssp

__all__ = ["Fmu", "export", "write_ssp"]
