"""A motion as a page, or as a glTF, in one call."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from mbfmu.direct import simulate
from mbfmu.errors import UserError
from mbfmu.mechanics import Mechanism
from mbfmu.model import Model, of_user
from mbfmu.result import Result

from .gltf import write_glb
from .html import write_html
from .motion import Motion, Recorder


def view(
    model: Model | Mechanism | Motion,
    path: Path | str = "motion.html",
    stop_time: float | None = None,
    *,
    against: Motion | str | None = None,
    **how: Any,
) -> Path:
    """Write an animation of a model's motion, one HTML file for any browser, and return its path.

    Parameters
    ----------
    model
        Model, mechanism, or recorded motion.
    path
        Path of the page; with the suffix ``.glb`` a binary glTF is written.
    stop_time, **how
        Arguments of :func:`mbfmu.simulate`.
    against
        Second motion, drawn translucent; or, for a model, the settings of a second run:
        ``"adams"``, ``"adams:1e-4"`` or ``":1e-4"``, solver and tolerance.

    Returns
    -------
    Path
        Path of the page.

    Raises
    ------
    UserError
        As :func:`mbfmu.simulate`; the run fails at its start; the file cannot be written; a glTF, which shows
        one motion, is requested for two.
    """
    path = Path(path)
    if path.suffix == ".glb" and against is not None:
        raise UserError(f"against requires an HTML page, but path is {str(path)!r}; write a file .html")
    if isinstance(model, Motion):
        if isinstance(against, str):
            raise UserError(f"against is {against!r}, but {model.title!r} is the record of a run; give another motion")
        motion, beside = model, against
    else:
        motion, beside = _runs(of_user(model), stop_time, against, how)
    if not path.parent.is_dir():
        raise UserError(f"folder {str(path.parent)!r} does not exist; create it first")
    if path.suffix == ".glb":
        write_glb(motion, path)
    else:
        write_html(motion, path, beside)
    return path


def _runs(
    model: Model, stop_time: float | None, against: Motion | str | None, how: dict[str, Any]
) -> tuple[Motion, Motion | None]:
    """Return the motion of a model and the second motion."""
    motion, result = _run(model, stop_time, how)
    if not isinstance(against, str):
        return motion, against
    beside, second = _run(model, stop_time, how | changes(against))
    return side_by_side(motion, result, beside, second)


def _run(model: Model, stop_time: float | None, how: dict[str, Any]) -> tuple[Motion, Result]:
    recorder = Recorder()
    result = simulate(model, stop_time, watch=recorder, **how)
    return recorder.motion(model.name), result


def side_by_side(motion: Motion, result: Result, beside: Motion, second: Result) -> tuple[Motion, Motion]:
    """Return two motions of one mechanism, each with the name of its run and both with one picture."""
    return replace(motion, title=result.title), replace(beside, title=second.title, picture=motion.picture)


def changes(text: str) -> dict[str, Any]:
    """Return what ``SOLVER``, ``SOLVER:RTOL`` or ``:RTOL`` changes in the settings of a run."""
    solver, colon, tolerance = text.partition(":")
    try:
        found = ({"solver": solver} if solver else {}) | ({"tolerance": float(tolerance)} if colon else {})
    except ValueError as error:
        raise UserError(
            f"against is {text!r}, whose {tolerance!r} is not a number; allowed: SOLVER, SOLVER:RTOL or :RTOL"
        ) from error
    if not found:
        raise UserError(f"against is {text!r}; allowed: SOLVER, SOLVER:RTOL or :RTOL")
    return found
