"""What is simulated, and how: models and their parameters, settings, scenes, and the variables of a model."""

from .model import Model
from .parameters import parameter
from .registry import find, models

__all__ = ["Model", "find", "models", "parameter"]
