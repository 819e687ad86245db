"""Models as FMUs, systems of FMUs, and a harness that drives an FMU."""

from .export import export
from .harness import Fmu
from .many import Batch, simulate_many
from .ssp import write_ssp

__all__ = ["Batch", "Fmu", "export", "simulate_many", "write_ssp"]
