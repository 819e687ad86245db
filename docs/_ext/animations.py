"""The animations of the gallery, made when the site has been built: they are too large to be kept in the repository."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sphinx.util import logging

import mbfmu

LOG = logging.getLogger(__name__)
MOTIONS = {  # of each model: end (s), time between frames (s), settings
    "fourbar": (6.0, 0.02, {"solver": "adams"}),
    "governor": (6.0, 0.02, {"solver": "adams"}),
    "pendulum": (2.0, 0.005, {"solver": "adams"}),
    "sheet": (0.5, 0.005, {"solver": "ida"}),
}


def write(app: Any, failure: Exception | None) -> None:
    """Write one page a model into ``animations`` of the site."""
    if failure is not None or app.builder.format != "html":
        return
    folder = Path(app.outdir) / "animations"
    folder.mkdir(exist_ok=True)
    for name, (end, interval, settings) in MOTIONS.items():
        page = mbfmu.view(mbfmu.find(name)(), folder / f"{name}.html", end, interval=interval, **settings)
        LOG.info("animation of %s: %.1f MB", name, page.stat().st_size / 1e6)


def setup(app: Any) -> dict[str, bool]:
    """Have them written at the end."""
    app.connect("build-finished", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
