"""Models from URDF and MJCF files: Python code, or the model itself."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Sequence
from hashlib import sha256
from pathlib import Path
from types import ModuleType

from mbfmu.modeling import Model
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError

from .closures import Closures
from .reader import read_file
from .writer import source_of


def load(
    path: Path | str,
    *,
    strict: bool = False,
    floating: bool = False,
    close: Closures = (),
    report: Callable[[str], object] | None = None,
) -> Model:
    """Return the model of a URDF or MJCF file.

    ``mbfmu import`` writes the same model as Python code. The package MuJoCo reads the file:
    ``pip install 'mbfmu[import]'``.

    Parameters
    ----------
    path
        URDF file (``<robot>``) or MJCF file (``<mujoco>``).
    strict
        Refuse files of which something is not imported that may change the motion.
    floating
        Bodies that the file fixes to the ground move freely, such as the base of a mobile robot.
    close
        Loop-closing joints, since URDF describes trees only: pairs of names of bodies whose frames coincide,
        ``("rod_end", "pin")``. A third word is the kind of the joint: ``"spherical"`` (default), ``"revolute"`` about
        the z axes of both frames, or ``"weld"``. ``"world"`` is the ground. The name of a TOML file: tables
        ``[[close]]`` with ``a``, ``b``, ``joint``, points ``at_a`` and ``at_b`` in the frames of the bodies (m), and
        ``axis_a`` and ``axis_b`` of a revolute joint.
    report
        Function that receives a message on everything that is not imported or is changed. None: a Python warning is
        given for what is not imported.

    Returns
    -------
    Model
        Model with masses, start positions, damping and other values as parameters, at their defaults of the file.

    Raises
    ------
    UserError
        MuJoCo is not installed; the file cannot be read, or it is not a valid model; a body in ``close`` does not
        exist; with ``strict``, something is not imported.
    """
    code, found = source_code(Path(path), strict=strict, floating=floating, close=close)
    for diagnostic in found:
        if report is not None:
            report(str(diagnostic))
        elif diagnostic.severity == "warning":
            warnings.warn(str(diagnostic), stacklevel=2)
    return model_of(code)


def source_code(
    path: Path, *, strict: bool = False, floating: bool = False, close: Closures = ()
) -> tuple[str, Sequence[Diagnostic]]:
    """Return the Python code of the model of a file, and what is not imported or is changed; see :func:`load`."""
    description = read_file(path, floating=floating, close=close)
    missing = [d for d in description.diagnostics if d.severity == "warning"]
    if strict and missing:
        texts = "; ".join(d.text.removeprefix("not imported: ") for d in missing)
        raise UserError(
            f"{str(path)!r}: {len(missing)} kinds of elements are not imported: {texts}. Remove them from the file, or "
            "import without the option strict",
            "not-imported",
        )
    return source_of(description), description.diagnostics


def model_of(code: str) -> Model:
    """Return the model that Python code of :func:`source_code` defines, built once as a check."""
    name = f"mbfmu_imported_{sha256(code.encode()).hexdigest()[:12]}"
    module = sys.modules.get(name)
    if module is None:
        module = ModuleType(name)
        vars(module)["__mbfmu_code__"] = code  # which an FMU that calls Python contains
        sys.modules[name] = module  # dataclasses search there for the module of a class
        exec(compile(code, f"<{name}>", "exec"), module.__dict__)
    found = [value for value in vars(module).values() if isinstance(value, type) and issubclass(value, Model)]
    model = next(cls for cls in found if cls.__module__ == name)()
    model.built()
    return model
