"""Signatures and fields for readers: arrays by a short name, and what comments say of the fields of a class."""

from __future__ import annotations

import dataclasses
import inspect
import re
from typing import Any

from mbfmu.modeling.parameters import declared, span

ARRAY = re.compile(r"(~?numpy\.)ndarray\[tuple\[[^\]]*\], ~?numpy\.dtype\[[^\]]*\]\]")
NAMED = re.compile(r"<function (\w+)>")
COMMENTED = re.compile(r"^    (\w+): [^#\n]+  # (.+)$", re.MULTILINE)


def shorten(app: Any, what: str, name: str, own: Any, options: Any, given: str | None, returned: str | None) -> Any:
    """Let an array be an ndarray, whose shape is in the docstring, and a function that is a default be its name."""
    return tuple(text and NAMED.sub(r"\1", ARRAY.sub(r"\1ndarray", text)) for text in (given, returned))


def describe(app: Any, what: str, name: str, own: Any, options: Any, lines: list[str]) -> None:
    """Add what a dataclass says of its fields: the meaning and range of a parameter, or the comment behind a field."""
    if what != "class" or not dataclasses.is_dataclass(own):
        return
    said = dict(COMMENTED.findall(inspect.getsource(own)))
    said |= {p.name: f"{p.doc} ({span(p)})" for p in declared(own)}
    known = "\n".join(lines)
    fields = [f for f in dataclasses.fields(own) if f.name in said and f":param {f.name}:" not in known]
    if fields:
        lines += ["", *(f":param {f.name}: {said[f.name]}" for f in fields), ""]


def setup(app: Any) -> dict[str, bool]:
    """Listen after napoleon."""
    app.connect("autodoc-process-signature", shorten)
    app.connect("autodoc-process-docstring", describe, priority=700)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
