"""Description of the mechanism in a URDF or MJCF file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError

from .closures import Closures
from .compiler import CompiledFile, compile_file
from .description import Description, ImportedJoint
from .losses import Losses, listed, printable
from .mujoco_shapes import add_geometries
from .mujoco_table import find_lost
from .names import identifier
from .relations import Relations
from .tree import Tree
from .urdf_joints import add_default_masses, apply_limits
from .urdf_shapes import add_visuals
from .urdf_table import add_elements

REPORTED_CORRECTION = 1e-9  # of an inertia, relative; smaller ones are rounding errors


def read_file(path: Path, *, floating: bool = False, close: Closures = ()) -> Description:
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
    if file.robot is not None:
        apply_limits(file.robot, tree, losses)
        add_default_masses(tree, file.robot, losses)
        add_elements(file.robot, losses)
    title = file.robot.get("name", "") if file.robot is not None else _model_name(file)
    given = title if title != "MuJoCo Model" else ""  # the name that MuJoCo gives to models without a name
    name = identifier(given) or identifier(path.stem) or "mechanism"
    description = Description(
        name=name.lower(),
        source=printable(path.name),
        origin=f"{file.format} file, compiled by MuJoCo {file.mujoco.__version__}",
        gravity=np.zeros(3) if file.disables("GRAVITY") else np.array(model.opt.gravity, float),
        bodies=tree.bodies,
        renamed=tree.renamed,
        folder=path.resolve().parent,
    )
    Relations(tree, description, losses).add_closures(close)
    if file.robot is not None:
        add_visuals(file.robot, tree, description, losses)
    else:
        add_geometries(tree, description, losses)
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
    check_finite(repr(str(path)), description)
    return description


def check_finite(what: str, description: Description) -> None:
    """Raise UserError if a number of the mechanism is not finite, such as the weight of a body of 1e308 kg."""
    if not np.all(np.isfinite(description.gravity)):
        raise UserError(f"{what}: gravity is not finite; correct the file")
    elements = [item for part in vars(description).values() if isinstance(part, list) for item in part]
    for element in (*elements, *(body.joint for body in description.bodies)):
        if isinstance(element, Diagnostic):
            continue
        for key, value in vars(element).items():
            parts = list(value.values()) if isinstance(value, dict) else [value]
            numbers = [part for part in parts if isinstance(part, float | tuple | np.ndarray)]
            if not all(np.all(np.isfinite(part)) for part in numbers):
                name = printable(element.name or element.body)
                raise UserError(
                    f"{what}: {key.replace('_', ' ')} of {name} is not a finite number; allowed: "
                    "numbers whose products are below 1e308. Correct the file"
                )


def starts_outside(joint: ImportedJoint) -> bool:
    """Whether the start of a joint is outside its range."""
    if joint.lower is None or joint.upper is None or joint.start is None:
        return False
    return not joint.lower <= joint.start[0] <= joint.upper


def add_losses(file: CompiledFile, losses: Losses) -> None:
    """Add the parts of a model of MuJoCo that no element of the description represents."""
    model = file.model
    for key, name in find_lost(model, file.disables, file.name_of):
        losses.add(key, name)
    if not file.disables("CONTACT", "CONSTRAINT"):
        for _ in range(file.contacts):
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
