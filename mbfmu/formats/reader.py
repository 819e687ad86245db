"""Description of the mechanism in a URDF or MJCF file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .compiler import CompiledFile, compile_file
from .description import Closure, Description, ImportedJoint
from .losses import Losses, listed, printable
from .names import identifier
from .relations import Relations
from .tree import Tree

REPORTED_CORRECTION = 1e-9  # of an inertia, relative; smaller ones are rounding errors


def read_file(path: Path, *, floating: bool = False, close: Sequence[Closure] = ()) -> Description:
    """Read a URDF or MJCF file.

    Parameters
    ----------
    path
        File.
    floating
        Bodies that the file fixes to the ground move freely.
    close
        Loop-closing joints, see :func:`.load`.

    Raises
    ------
    UserError
        MuJoCo is not installed, the file cannot be read, it is not a valid model, or a name in ``close`` is unknown.
    """
    file, losses = compile_file(path, floating=floating), Losses()
    model = file.model
    tree = Tree(file, losses)
    title = file.robot.get("name", "") if file.robot is not None else _model_name(file)
    given = title if title != "MuJoCo Model" else ""  # the name that MuJoCo gives to models without a name
    name = identifier(given) or identifier(path.stem) or "mechanism"
    description = Description(
        name=name.lower(),
        source=printable(path.name),
        origin=f"{file.format} file, compiled by MuJoCo {file.mujoco.__version__}",
        gravity=np.array(model.opt.gravity, float),
        bodies=tree.bodies,
        renamed=tree.renamed,
    )
    Relations(tree, description, losses).add_closures(close)
    if file.disables("GRAVITY"):
        description.gravity = np.zeros(3)
    if file.disables("SPRING", "DAMPER"):
        losses.add("flags")
    add_losses(file, losses)
    with_range = [joint.name for _, joint in tree.of_joint if joint.lower is not None]
    if with_range:
        losses.note(
            f"ranges of joints ({len(with_range)}) are elastic stops",
            "Their stiffness is that of MuJoCo in the start position, their damping that of the parameters; the "
            "parameter stops = false removes them",
        )
        outside = [joint.name for _, joint in tree.of_joint if starts_outside(joint)]
        if outside:
            losses.note(
                f"start positions are outside the ranges ({listed(outside)})",
                "The stops push these joints at the start. Set other start positions",
            )
    description.diagnostics += losses.diagnostics()
    return description


def starts_outside(joint: ImportedJoint) -> bool:
    """Whether the start of a joint is outside its range."""
    if joint.lower is None or joint.upper is None or joint.start is None:
        return False
    return not joint.lower <= joint.start[0] <= joint.upper


def add_losses(file: CompiledFile, losses: Losses) -> None:
    """Add the parts of a model of MuJoCo that no element of the description represents."""
    model = file.model
    if not file.disables("CONTACT", "CONSTRAINT"):
        for _ in np.flatnonzero(model.geom_contype | model.geom_conaffinity):
            losses.add("contact")
    if model.opt.density or model.opt.viscosity:
        losses.add("fluid")
    if model.nflex:
        losses.add("flex")
    if model.nplugin:
        losses.add("plugin")
    if model.nkey:
        losses.note("keyframes are not used", "The start is the position zero of the file")
    corrected = [printable(name) for name, own in file.inertias.items() if own.correction > REPORTED_CORRECTION]
    if corrected:
        size = max(own.correction for own in file.inertias.values())
        losses.note(
            f"inertias of bodies are corrected by up to {size:.1g} ({listed(corrected)})",
            "The largest principal moment was larger than the sum of the two others, or one was negative",
        )
    for text in file.warnings:
        losses.note(f"MuJoCo reports: {' '.join(text.split())}")


def _model_name(file: CompiledFile) -> str:
    """Return the name of a model of MuJoCo."""
    names = bytes(file.model.names)
    return names[: names.find(b"\0")].decode("utf-8", "replace")
