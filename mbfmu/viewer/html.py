"""The interactive page: one file with the motion, the drawing program and nothing from the network.

WebGL is used without a library: three.js would replace an estimated 180 of 1840 lines of scripts (shading, shadows,
lines and the fit of the camera would stay) and add 0.57 MB to every page, which has 0.15 MB without the motion.
"""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import asdict
from html import escape
from importlib.resources import files
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from mbfmu.util.files import write_text

from .camera import Stage
from .fields import COLOR_STOPS, fields, hull_fields
from .forces import scales
from .motion import Motion

SCRIPTS = (
    "algebra", "solids", "motion", "camera", "renderer", "figure", "arrows", "stage", "clock", "pick", "plot",
    "input_controls", "viewer",
)  # fmt: skip
MAX_PAGE_BYTES = 14_000_000  # bytes of numbers in a page, before they are packed


def write_html(motion: Motion, path: Path, against: Motion | None = None) -> int:
    """Write the page; return the stride with which it takes frames (more than 1: it would have been too large).

    ``against`` is the motion of another run, drawn with the first and translucent.
    """
    text, stride = page(motion, against)
    write_text(path, text)
    return stride


def page(motion: Motion, against: Motion | None = None) -> tuple[str, int]:
    """Return the page and the stride with which it takes frames."""
    runs = [motion] if against is None else [motion, against]
    stride = ceil(sum(map(size, runs)) / MAX_PAGE_BYTES)
    picture, stage = motion.picture, Stage.of(*runs)
    bodies = len(motion.names) - 1 - len(picture.unnamed)
    scene = described(motion, *runs) | {
        "note": " · ".join(filter(None, (f"{bodies} {'body' if bodies == 1 else 'bodies'}", motion.caption))),
        "scale": motion.scale,
        "stage": stage.as_dict(),
        "scales": scales(motion.arrows, motion.forces, 2.0 * float(np.linalg.norm(stage.half))),
        "against": described(against, *runs) if against else None,
        "stops": COLOR_STOPS,
    }
    own, kept = files(__package__) / "page", files(__package__) / "vendor"
    license = (kept / "uPlot.LICENSE").read_text(encoding="utf-8")
    parts = {
        "title": escape(motion.title),
        "style": (own / "page.css").read_text(encoding="utf-8"),
        "plot_style": (kept / "uPlot.min.css").read_text(encoding="utf-8"),
        "plot_script": f"/*! {license}*/\n" + (kept / "uPlot.iife.min.js").read_text(encoding="utf-8"),
        "scene": json.dumps(scene).replace("<", "\\u003c"),
        "blocks": blocks(motion, stride, "") + (blocks(against, stride, "-against") if against else ""),
        "script": '"use strict";\n' + "\n".join((own / f"{name}.js").read_text(encoding="utf-8") for name in SCRIPTS),
    }
    template = (own / "page.html").read_text(encoding="utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], template), stride


def size(motion: Motion) -> int:
    """Return how many bytes of numbers a page has of a motion."""
    poses = 3 * len(motion.names) + 4 * len(turning_bodies(motion)) + motion.p.shape[1]
    return 4 * len(motion.times) * int(poses + len(motion.outputs) + 3 * len(motion.arrows))


def described(motion: Motion, *runs: Motion) -> dict[str, Any]:
    """Return the data of one of the runs of a page, without its values over time."""
    return {
        "title": motion.title,
        "bodies": motion.names,
        "parents": motion.parents,
        "joints": motion.joints,
        "turning": turning_bodies(motion),
        "picture": motion.picture.as_dict(),
        "outputs": [
            {"name": name, "unit": unit, "base": base}
            for (name, unit), base in zip(motion.outputs, bases(motion), strict=True)
        ],
        "arrows": [asdict(arrow) for arrow in motion.arrows],
        "fields": [field and asdict(field) for field in fields(motion, *runs)],
        "hull_fields": [asdict(field) for field in hull_fields(motion, *runs)],
    }


def bases(motion: Motion) -> list[float]:
    """Return the first value of every output: single precision shows how little an energy strays from it."""
    return [float(np.where(np.isfinite(first), first, 0.0)) for first in motion.values[0]]


def blocks(motion: Motion, stride: int, suffix: str) -> str:
    """Return the numbers of a run as elements of the page, at every ``stride``-th frame and the last."""
    frames = np.unique(np.append(np.arange(0, len(motion.times), stride), len(motion.times) - 1))
    content = {
        "times": packed(motion.times[frames], "<f8"),
        "positions": packed(motion.r[frames], "<f4"),
        "quaternions": packed(motion.e[frames][:, turning_bodies(motion)], "<f4"),
        "amplitudes": packed(motion.p[frames], "<f4"),
        "outputs": packed(motion.values[frames] - bases(motion), "<f4"),
        "forces": packed(motion.forces[frames], "<f4"),
    }
    kind = "application/octet-stream"
    return "\n".join(f'<script type="{kind}" id="{name}{suffix}">{text}</script>' for name, text in content.items())


def turning_bodies(motion: Motion) -> list[int]:
    """Return the bodies whose orientation shows: with parts, or with a point off their origin."""
    picture = motion.picture
    ends = [*enumerate(picture.middles)]
    ends += [(link.a, link.at_a) for link in picture.links] + [(link.b, link.at_b) for link in picture.links]
    ends += [(body, skin.at) for skin in picture.skins for row in skin.bodies for body in row]
    whole = {thing.body for things in (picture.parts, picture.bars, picture.hulls) for thing in things}
    return sorted(whole | {body for body, at in ends if any(at)})


def packed(array: Any, kind: str) -> str:
    """Return numbers over time (T, ...) of a kind, packed, as base64.

    As words of 32 bits, each less the one a frame before: neighbors share their high bytes, which then are zero. All
    first bytes come before all second ones, so that they lie together; a third to a fifth is left.
    """
    words = np.ascontiguousarray(array, kind).reshape(len(array), -1).view("<u4")
    steps = np.ascontiguousarray(np.diff(words, axis=0, prepend=np.uint32(0)).T, "<u4")
    planes = np.ascontiguousarray(steps.view(np.uint8).reshape(-1, 4).T)
    return base64.b64encode(zlib.compress(planes.tobytes(), 9)).decode()
