"""Mistakes a user can make; the message names the thing, its value and what is allowed."""

from __future__ import annotations


class UserError(ValueError):
    """Base of every error the command line prints without a traceback."""


class AssemblyError(UserError):
    """The loops of a mechanism cannot be closed, or its start is not consistent."""


class EquilibriumError(UserError):
    """No steady state was found, or what was found is none; the message gives the residual."""
