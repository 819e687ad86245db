"""Draw the pictures of the page on elements: ``python docs/element_pictures.py`` draws all, names after it some."""

from __future__ import annotations

import sys
from pathlib import Path

from sketches import blocks, forces, friction, joints  # noqa: F401 they register their pictures
from sketches.sketch import PICTURES

FOLDER = Path(__file__).parent / "figures" / "elements"


def main(names: list[str]) -> None:
    """Write the pictures of some elements, of all if none is named."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in names or PICTURES:
        (FOLDER / f"{name}.png").write_bytes(PICTURES[name]().png())


if __name__ == "__main__":
    main(sys.argv[1:])
