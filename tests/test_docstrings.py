"""Docstrings of public classes, functions and methods describe every parameter and what is returned."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import mbfmu
from mbfmu import mechanics, sheets
from mbfmu.mechanics.kind import ElementType
from mbfmu.mechanics.sensors import Sensor
from mbfmu.mechanics.shapes import Shape

# Their methods are called by the package and described once, in the base class.
HOOKED = (ElementType, Sensor, Shape, mechanics.CompiledMechanism)


def section(text: str, title: str) -> str:
    """Return the text of one section of a docstring in the style of NumPy."""
    found = re.search(rf"^{title}\n-+\n(.*?)(?=^\w[\w ]*\n-+\n|\Z)", text, re.MULTILINE | re.DOTALL)
    return found.group(1) if found else ""


def described(text: str) -> set[str]:
    """Return the names that the sections Parameters and Attributes describe."""
    lines = (section(text, "Parameters") + section(text, "Attributes")).splitlines()
    return {name.lstrip("*") for line in lines if re.match(r"[\w*]", line) for name in line.split(", ")}


def texts(found: Any) -> list[str]:
    """Return the docstring of a function, or those of a class and its bases."""
    classes = (
        [c for c in found.__mro__ if c.__module__.split(".")[0] in ("mbfmu", "solvers")] if is_class(found) else []
    )
    return [inspect.cleandoc(one.__doc__ or "") for one in classes or [found]]


def commented(found: Any) -> set[str]:
    """Return the fields of a dataclass that a comment describes, or the declaration of a parameter."""
    if not dataclasses.is_dataclass(found):
        return set()
    lines = [line for c in inspect.getmro(found)[:-1] for line in inspect.getsource(c).splitlines()]  # type: ignore[arg-type]
    own = {match.group(1) for line in lines if (match := re.match(r"    (\w+): [^#]*#", line))}
    return own | {field.name for field in dataclasses.fields(found) if field.metadata.get("doc")}


def is_class(found: Any) -> bool:
    """Return whether an object is a class."""
    return inspect.isclass(found)


def missing(found: Any) -> list[str]:
    """Return the parameters of a callable that its docstring does not describe."""
    if found is sheets.Surface:  # its constructor is that of its subclasses
        return []
    begun = is_class(found) and inspect.isfunction(found.__init__)  # not by __new__, which only checks names
    called = inspect.signature(found.__init__ if begun else found)
    names = [n for n in called.parameters if n not in ("self", "cls") and not n.startswith("_")]
    known = set[str]().union(*map(described, texts(found)), commented(found))
    return [name for name in names if name not in known]


def public() -> Iterator[tuple[str, Any]]:
    """Yield the public classes and functions by name."""
    for module in (mbfmu, mechanics, sheets):
        for name in module.__all__:
            found = getattr(module, name)
            if inspect.isclass(found) or inspect.isfunction(found):
                yield name, found


def methods() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield the public methods of classes that users call, by name."""
    for name, found in public():
        if is_class(found) and not issubclass(found, HOOKED):
            for key, method in inspect.getmembers(found, lambda one: inspect.isfunction(one) or inspect.ismethod(one)):
                if not key.startswith("_") and method.__module__.startswith("mbfmu."):
                    yield f"{name}.{key}", method


PUBLIC, METHODS = dict(public()), dict(methods())


@pytest.mark.parametrize("name", PUBLIC)
def test_every_parameter_is_described(name: str) -> None:
    assert missing(PUBLIC[name]) == []


@pytest.mark.parametrize("name", METHODS)
def test_every_parameter_of_a_method_is_described(name: str) -> None:
    assert missing(METHODS[name]) == []


@pytest.mark.parametrize("name", [name for name, found in PUBLIC.items() if not is_class(found)])
def test_what_a_function_returns_is_described(name: str) -> None:
    assert section(texts(PUBLIC[name])[0], "Returns")


def test_the_test_finds_what_is_missing() -> None:
    def halve(value: float, digits: int) -> float:
        """Return half of a value.

        Parameters
        ----------
        value
            A number.
        """
        return round(value / 2.0, digits)

    assert missing(halve) == ["digits"]
    assert not section(texts(halve)[0], "Returns")
