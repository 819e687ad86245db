"""The pictures of the reference of elements: every element has one, and it is the one that the script draws."""

from __future__ import annotations

import inspect
import re
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from element_pictures import FOLDER, PICTURES
from PIL import Image

from mbfmu import mechanics, sheets
from mbfmu.mechanics import Coupling, CutJoint, Force, Joint
from mbfmu.sheets import Surface

ROOT = Path(__file__).parents[1]
BASES = (Joint, CutJoint, Coupling, Force, Surface)
ELEMENTS = {
    name
    for package in (mechanics, sheets)
    for name, item in vars(package).items()
    if name in package.__all__ and inspect.isclass(item) and issubclass(item, BASES) and item not in BASES
} | {"Plate", "Shell", "pressure", "nip", "rope", "armature"}
BLOCKS = {  # methods of a mechanism
    "state", "lag", "transfer_function", "state_space", "limiter", "weighted_sum", "pid", "dc_motor", "sample_hold",
    "sampled_system",
}  # fmt: skip
ELEMENTS |= BLOCKS


def test_every_element_has_a_picture_on_the_page() -> None:
    page = (ROOT / "docs" / "kinds.md").read_text()
    assert len(ELEMENTS) > 35
    assert all(callable(getattr(mechanics.Mechanism, name)) for name in BLOCKS)
    assert set(PICTURES) == ELEMENTS
    assert sorted(re.findall(r"figures/elements/(\w+)\.png", page)) == sorted(ELEMENTS)
    assert {path.stem for path in FOLDER.iterdir()} == ELEMENTS
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 600_000


@pytest.mark.parametrize("name", sorted(PICTURES))
def test_the_picture_is_what_the_script_draws(name: str) -> None:
    """Pixels differ with the version of matplotlib, by less than what a moved arrow changes."""
    drawn, kept = (
        np.asarray(Image.open(file).convert("RGBA"), float)
        for file in (BytesIO(PICTURES[name]().png()), FOLDER / f"{name}.png")
    )
    assert drawn.shape == kept.shape
    assert np.abs(drawn - kept).mean() < 1.0
    assert drawn[..., 3].mean() > 10.0  # something is drawn
