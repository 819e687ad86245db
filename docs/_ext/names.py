"""References in docstrings, and docstrings of properties as they are written.

A docstring names what it means as its own module knows it; the site has public names. What is no part of the site must
exist all the same.
"""

from __future__ import annotations

import pkgutil
from typing import Any

from sphinx.util.nodes import make_refnode

ONE, TWO = ("class", "func", "exc", "data", "obj"), ("meth", "attr")  # roles: so many parts of a name tell what it is
KEPT: dict[str, list[str]] = {}  # docstrings of properties, by name


def resolve(app: Any, env: Any, node: Any, text: Any) -> Any:
    """Return a link to the public name of what a docstring refers to, or plain text where that is not on the site."""
    if node.get("refdomain") != "py":
        return None
    target, role = node["reftarget"].lstrip("."), node["reftype"]
    parts = 1 if role in ONE else 2 if role in TWO else 0
    objects = env.domains["py"].objects
    tail = target.split(".")[-parts:]
    found = [name for name in objects if parts and name.split(".")[-parts:] == tail and not objects[name].aliased]
    if len(found) == 1:
        own = objects[found[0]]
        return make_refnode(app.builder, node["refdoc"], own.docname, own.node_id, text, found[0])
    return text if exists(target) else None


def exists(name: str) -> bool:
    """Whether a dotted name can be imported."""
    try:
        pkgutil.resolve_name(name)
    except (ImportError, AttributeError, ValueError):
        return False
    return True


def keep(app: Any, what: str, name: str, own: Any, options: Any, lines: list[str]) -> None:
    """Keep a property's docstring: napoleon takes what stands before its first colon for a type."""
    if what == "property":
        KEPT[name] = list(lines)


def put_back(app: Any, what: str, name: str, own: Any, options: Any, lines: list[str]) -> None:
    """Undo what napoleon made of it."""
    if what == "property":
        lines[:] = KEPT.pop(name)


def setup(app: Any) -> dict[str, bool]:
    """Listen before and after napoleon."""
    app.connect("missing-reference", resolve)
    app.connect("autodoc-process-docstring", keep, priority=400)
    app.connect("autodoc-process-docstring", put_back, priority=600)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
