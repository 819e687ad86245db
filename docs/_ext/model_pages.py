"""Links to the README of a model lead to the page of the site that includes it.

In the repository a link such as ``../fmus/sheet/README.md#limits`` leads to the text itself. On the site the same text
is the page ``models/sheet.md``.
"""

from __future__ import annotations

import re
from typing import Any

LINK = re.compile(r"\]\(((?:\.\./)*)\.\./fmus/(\w+)/README\.md")


def lead_to_pages(_app: Any, _name: str, source: list[str]) -> None:
    """Change the links in the text of a page before it is parsed."""
    source[0] = LINK.sub(r"](\1models/\2.md", source[0])


def setup(app: Any) -> dict[str, bool]:
    """Connect to the reading of pages."""
    app.connect("source-read", lead_to_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
