"""Models as FMI 2.0 co-simulation FMUs: export, and a harness that drives them."""

from .export import export
from .harness import Fmu

__all__ = ["Fmu", "export"]
