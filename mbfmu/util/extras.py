"""Packages that only some calls need."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from .errors import UserError


def import_optional(name: str, extra: str = "") -> Any:
    """Import a package that only this needs, one of an extra of mbfmu's; raises UserError where it is not installed."""
    try:
        return import_module(name)
    except ImportError as error:
        what = f"'mbfmu[{extra}]'" if extra else name
        raise UserError(f"this needs the package {name!r}: pip install {what}") from error
