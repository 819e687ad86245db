"""Formulas as MathML, which browsers draw themselves: no script, and no network to read a page."""

from __future__ import annotations

from typing import Any

from docutils.nodes import SkipNode
from latex2mathml.converter import convert
from sphinx.util import logging

LOG = logging.getLogger(__name__)


def written(node: Any, how: str) -> str:
    """Return the MathML of a formula; a command that is not known is a warning, and so an error in a strict build."""
    text = str(convert(node.astext(), display=how))
    if "\\" in text:
        LOG.warning("a formula has a command that has no MathML: %s", node.astext(), location=node)
    return text


def inline(translator: Any, node: Any) -> None:
    """Write a formula into a line."""
    translator.body.append(written(node, how="inline"))
    raise SkipNode


def display(translator: Any, node: Any) -> None:
    """Write a formula on lines of its own."""
    translator.body.append(f'<div class="math">{written(node, how="block")}</div>\n')
    raise SkipNode


def setup(app: Any) -> dict[str, bool]:
    """Offer the renderer to Sphinx."""
    app.add_html_math_renderer("mathml", inline_renderers=(inline, None), block_renderers=(display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
