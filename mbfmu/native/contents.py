"""What the libraries of the runtime contain: the only list of their parts.

A part is one object file: a table of kernels of element types, or entry points of a family. A library has the parts
that its model can call, which are in the data of the model. A model that is made for one run needs neither model
exchange nor derivatives, and a mechanism without sheets none of their kernels. This saves half of the time of the
first build. Entry points and numbers of kernels that a library does not have are refused when a model is loaded.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple, TypeVar

from .kernel_table import kernel_tables

Anything = TypeVar("Anything")

EQUATIONS, STEPS = "equations", "steps"
# Entry points of a family by the part that they are in: those of a name, or of names that begin with it and "_". STEPS
# has what is not listed. EQUATIONS has most of what the others call, which is not compiled twice then.
ENTRY_PARTS: dict[str, tuple[str, ...]] = {
    EQUATIONS: ("assemble", "begin"),
    STEPS: (),
    "exchange": ("exchange",),  # model exchange and derivatives
    "steady": ("balance",),  # start in a steady state
    "events": ("events",),  # steps of models with events
    "profiles": ("locate_contact",),  # warnings of wheels on profiles
}


class Contents(NamedTuple):
    """What a library contains."""

    family: str
    parts: tuple[str, ...]  # tables of kernels by their names, then parts of ENTRY_PARTS

    @property
    def name(self) -> str:
        """The name of a library, without that of its target."""
        return "-".join((self.family, *self.parts))

    def entries(self, known: Mapping[str, Anything]) -> dict[str, Anything]:
        """Return those of the entry points of the family that the library has."""
        return {name: own for name, own in known.items() if entry_part(name) in self.parts}

    def objects(self) -> list[str]:
        """Return the names of the object files, without that of their target."""
        return [f"{self.family}-{name}" if name in ENTRY_PARTS else name for name in self.parts]


def entry_part(name: str) -> str:
    """Return the part that an entry point is in."""
    own = (part for part, words in ENTRY_PARTS.items() for word in words if name == word or name.startswith(f"{word}_"))
    return next(own, STEPS)


def complete(family: str) -> Contents:
    """Return the contents of a library that serves every model of a family."""
    return Contents(family, (*kernel_tables(), *ENTRY_PARTS))


def contents_for(
    family: str, numbers: Iterable[int], *, exchanges: bool, is_steady: bool, has_events: bool, has_profiles: bool
) -> Contents:
    """Return the contents of a library for a model.

    Parameters
    ----------
    family
        Family of :mod:`.families`.
    numbers
        Numbers of the kernels that the model calls, see :func:`.kernel_table.numbers_in_fmu`.
    exchanges
        Whether it supports model exchange.
    is_steady
        Whether it starts in a steady state.
    has_events
        Whether it has events.
    has_profiles
        Whether it has wheels that roll on profiles.
    """
    called, tables, first = set(numbers), [], 0
    for name, table in kernel_tables().items():
        if not called.isdisjoint(range(first, first + len(table.kernels))):
            tables.append(name)
        first += len(table.kernels)
    needed = {"exchange": exchanges, "steady": is_steady, "events": has_events, "profiles": has_profiles}
    unused = {part for part, is_needed in needed.items() if not is_needed}
    return Contents(family, (*tables, *(name for name in ENTRY_PARTS if name not in unused)))
