"""Kernel templates: one text for kernels that differ only in the functions that they call.

A *template* is a function in plain Python whose calls of *hooks* are replaced when a module makes a kernel of it. So a
step loop is written once and compiled for every method, as if it had been written there: a function that is passed as
an argument has another type in every process, so that machine code could not be stored.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import FunctionType
from typing import Any, TypeVar, cast

from .kernel import kernel

F = TypeVar("F", bound=Callable[..., Any])


def specialize(template: F, module: str, hooks: Mapping[str, Any]) -> F:
    """Return a kernel of a template; arguments are those of :func:`substitute`.

    Returns
    -------
    function
        Compiled function; with ``NUMBA_DISABLE_JIT=1`` plain Python.
    """
    return kernel(substitute(template, module, hooks))


def substitute(template: F, module: str, hooks: Mapping[str, Any]) -> F:
    """Return a template with its hooks as plain Python.

    Parameters
    ----------
    template
        Function that is no kernel.
    module
        Name of the module to which the kernel belongs; it must import that of the template.
    hooks
        Functions by the names under which the template calls them; those that it does not call are ignored.
    """
    original = cast(FunctionType, template)
    names = {**original.__globals__, **hooks, "__name__": module}
    function = FunctionType(original.__code__, names, original.__name__)
    function.__doc__, function.__annotations__ = original.__doc__, original.__annotations__
    return cast(F, function)


def require_hooks(names: tuple[str, ...], module: str, given: Mapping[str, Any]) -> None:
    """Raise TypeError unless a module gives exactly the hooks of these names."""
    wrong = sorted(set(names) ^ set(given))
    if wrong:
        raise TypeError(
            f"module {module!r}: hooks {', '.join(wrong)} are missing or unknown; allowed: {', '.join(names)}"
        )
