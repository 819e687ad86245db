"""Every link within the built site leads somewhere, those of raw HTML too."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from sphinx.errors import SphinxError


class Page(HTMLParser):
    """The links of a page, and the places in it that links may lead to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.places: set[str] = set()
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what a tag links to and what it is called."""
        for name, value in attrs:
            if name in ("href", "src") and value:
                self.links.append(value)
            elif name == "id" and value:
                self.places.add(value)


def broken(root: Path) -> list[str]:
    """Return a line for every link within the site that leads nowhere."""
    pages = {path: Page(path) for path in root.rglob("*.html")}
    lines = []
    for path, page in pages.items():
        for link in page.links:
            url = urlsplit(link)
            if url.scheme or url.netloc:
                continue
            target = (path.parent / unquote(url.path)).resolve() if url.path else path
            place = unquote(url.fragment)
            if not target.exists() or (place and target in pages and place not in pages[target].places):
                lines.append(f"{path.relative_to(root)}: {link}")
    return lines


def check(app: Any, failure: Exception | None) -> None:
    """Fail the build where a link is broken."""
    if failure is None and app.builder.format == "html":
        lines = broken(Path(app.outdir).resolve())
        if lines:
            raise SphinxError("links that lead nowhere:\n" + "\n".join(lines))


def setup(app: Any) -> dict[str, bool]:
    """Look when the site and its animations have been written."""
    app.connect("build-finished", check, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
