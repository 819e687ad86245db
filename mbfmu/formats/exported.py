"""MJCF and URDF files of models."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from mbfmu.modeling import Model
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError
from mbfmu.util.files import write_text

from .description import Description
from .export_losses import ExportLosses
from .mechanism import Described
from .mjcf_writer import mjcf_of
from .urdf_writer import urdf_of

Writer = Callable[[Description, Path, ExportLosses], str]


def write_mjcf(model: Model, path: Path | str, *, strict: bool = False) -> Sequence[Diagnostic]:
    """Write the rigid mechanism of a model as an MJCF file of MuJoCo, for training or viewing in other programs.

    Bodies, joints, masses, springs, dampers, Coulomb friction, ranges, armatures, loops, gears, drives with an input,
    points whose positions are outputs, and shapes are written. MuJoCo is not required.

    Parameters
    ----------
    model
        Model of rigid bodies.
    path
        File; an existing one is overwritten.
    strict
        Refuse models of which something is not exported.

    Returns
    -------
    list
        Messages on everything that is not exported or is changed.

    Raises
    ------
    UserError
        A joint or a body has no counterpart; with ``strict``, something is not exported.
    """
    return _write(model, Path(path), mjcf_of, strict)


def write_urdf(model: Model, path: Path | str, *, strict: bool = False) -> Sequence[Diagnostic]:
    """Write the rigid mechanism of a model as a URDF file.

    URDF describes trees: loops are not exported. Masses, damping, friction, ranges, gears (mimic) and shapes are.

    Parameters
    ----------
    model, path, strict
        As for :func:`write_mjcf`.

    Returns
    -------
    list
        Messages on everything that is not exported or is changed.

    Raises
    ------
    UserError
        As for :func:`write_mjcf`.
    """
    return _write(model, Path(path), urdf_of, strict)


def _write(model: Model, path: Path, write: Writer, strict: bool) -> Sequence[Diagnostic]:
    """Write a file in one of the formats."""
    losses = ExportLosses()
    described = Described(model.compile(), model.name, losses)
    text = write(described.description, path.resolve().parent, losses)
    found = losses.diagnostics()
    missing = [d.text.removeprefix("not exported: ") for d in found if d.severity == "warning"]
    if strict and missing:
        raise UserError(
            f"{model.name!r}: {len(missing)} kinds of elements are not exported: {'; '.join(missing)}. Remove them "
            "from the model, or export without the option strict",
            "not-exported",
        )
    write_text(path, text)
    return found
