"""Tests of user-defined element types: identities that hold for every mechanism, whatever its numbers are."""

from .check import ElementReport, Outcome, check_element

__all__ = ["ElementReport", "Outcome", "check_element"]
