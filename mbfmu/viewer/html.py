"""The interactive page: one file with the motion, the drawing program and nothing from the network."""

from __future__ import annotations

import base64
import json
import re
from html import escape
from importlib.resources import files
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from mbfmu.errors import UserError

from .camera import Stage
from .motion import Motion

SCRIPTS = ("algebra", "solids", "motion", "camera", "renderer", "stage", "viewer")
LARGEST = 14_000_000  # bytes of poses in a page; base64 makes a third more of them


def write_html(motion: Motion, path: Path) -> int:
    """Write the page; return the stride with which it takes frames (more than 1: it would have been too large)."""
    text, stride = page(motion)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"{str(path)!r} cannot be written: {error.strerror}") from error
    return stride


def page(motion: Motion) -> tuple[str, int]:
    """Return the page and the stride with which it takes frames."""
    turning = turning_bodies(motion)
    size = 4 * len(motion.times) * (3 * len(motion.names) + 4 * len(turning) + motion.p.shape[1])
    stride = ceil(size / LARGEST)
    frames = np.unique(np.append(np.arange(0, len(motion.times), stride), len(motion.times) - 1))
    picture = motion.picture
    bodies = len(motion.names) - 1 - len(picture.unnamed)
    scene = {
        "title": motion.title,
        "note": " · ".join(filter(None, (f"{bodies} {'body' if bodies == 1 else 'bodies'}", motion.caption))),
        "scale": motion.scale,
        "bodies": motion.names,
        "turning": turning,
        "picture": picture.as_dict(),
        "stage": Stage.of(motion).as_dict(),
    }
    folder = files(__package__) / "page"
    parts = {
        "title": escape(motion.title),
        "style": (folder / "page.css").read_text(encoding="utf-8"),
        "scene": json.dumps(scene).replace("<", "\\u003c"),
        "times": encoded(motion.times[frames], "<f8"),
        "positions": encoded(motion.r[frames], "<f4"),
        "quaternions": encoded(motion.e[frames][:, turning], "<f4"),
        "amplitudes": encoded(motion.p[frames], "<f4"),
        "script": '"use strict";\n'
        + "\n".join((folder / f"{name}.js").read_text(encoding="utf-8") for name in SCRIPTS),
    }
    template = (folder / "page.html").read_text(encoding="utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], template), stride


def turning_bodies(motion: Motion) -> list[int]:
    """Return the bodies whose orientation shows: with parts, or with a point off their origin."""
    picture = motion.picture
    ends = [*enumerate(picture.middles)]
    ends += [(link.a, link.at_a) for link in picture.links] + [(link.b, link.at_b) for link in picture.links]
    ends += [(body, skin.at) for skin in picture.skins for row in skin.bodies for body in row]
    whole = {part.body for part in picture.parts} | {bar.body for bar in picture.bars}
    return sorted(whole | {body for body, at in ends if any(at)})


def encoded(array: Any, kind: str) -> str:
    """Return numbers of a kind as base64."""
    return base64.b64encode(np.ascontiguousarray(array, kind).tobytes()).decode()
