"""A motion as a page, a glTF, an image or a film, in one call."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mbfmu.mechanics import Mechanism
from mbfmu.mechanics.numbers import is_finite
from mbfmu.modeling.model import Model, as_model
from mbfmu.session.result import Result
from mbfmu.session.run import simulate
from mbfmu.util.errors import UserError

from .gltf import write_glb
from .html import write_html
from .motion import Motion, Recorder

PAGES, IMAGES = (".html", ".htm"), (".png", ".gif", ".mp4")


def view(
    model: Model | Mechanism | Motion,
    path: Path | str = "motion.html",
    stop_time: float | None = None,
    *,
    against: Motion | str | None = None,
    time: float | None = None,
    camera: tuple[float, float] | None = None,
    **how: Any,
) -> Path:
    """Write an animation of a model's motion, one HTML file for any browser, or an image or a film.

    Parameters
    ----------
    model
        Model, mechanism, or recorded motion.
    path
        Path of the file, whose suffix selects its type: ``.html`` page, ``.glb`` binary glTF, ``.png`` image, ``.gif``
        or ``.mp4`` film in real time; ``.mp4`` requires the program ffmpeg.
    stop_time, **how
        Arguments of :func:`mbfmu.simulate`.
    against
        Second motion, drawn translucent; or, for a model, the settings of a second run:
        ``"adams"``, ``"adams:1e-4"`` or ``":1e-4"``, solver and tolerance.
    time
        Time of an image, s; None: the start.
    camera
        Azimuth and elevation of the view direction of images and films, degrees; None: chosen from the motion.

    Returns
    -------
    Path
        Path of the file.

    Raises
    ------
    UserError
        As :func:`mbfmu.simulate`; the run fails at its start; the file cannot be written; an argument is not one for
        this type of file.
    """
    path = Path(path)
    _check(path, against, time, camera)
    if isinstance(model, Motion):
        if isinstance(against, str):
            raise UserError(f"against is {against!r}, but {model.title!r} is the record of a run; give another motion")
        motion, beside = model, against
    else:
        motion, beside = _runs(as_model(model), stop_time, against, how)
    if path.suffix in IMAGES:
        _write_image(motion, path, time, camera)
    elif path.suffix == ".glb":
        write_glb(motion, path)
    else:
        write_html(motion, path, beside)
    return path


def _check(path: Path, against: Motion | str | None, time: float | None, camera: tuple[float, float] | None) -> None:
    """Refuse files of an unknown type or in no folder, and arguments that do not belong to the type."""
    if path.suffix not in (*PAGES, ".glb", *IMAGES):
        raise UserError(f"path is {str(path)!r}; the file's name must end in .html, .glb, .png, .gif or .mp4")
    if path.suffix not in PAGES and against is not None:
        raise UserError(f"against requires an HTML page, but path is {str(path)!r}; write a file .html")
    if path.suffix != ".png" and time is not None:
        raise UserError(f"time requires an image, but path is {str(path)!r}; write a file .png")
    if path.suffix not in IMAGES and camera is not None:
        raise UserError(f"camera requires an image or a film, but path is {str(path)!r}; write a file .png or .gif")
    if camera is not None and (np.shape(camera) != (2,) or not is_finite(camera)):
        raise UserError(f"camera is {camera!r}; allowed: azimuth and elevation in degrees, such as (30, 20)")
    if not path.parent.is_dir():
        raise UserError(f"folder {str(path.parent)!r} does not exist; create it first")


def _write_image(motion: Motion, path: Path, time: float | None, camera: tuple[float, float] | None) -> None:
    """Write an image or a film."""
    from .images import Shot, write_film, write_png

    azimuth, elevation = camera or (None, None)
    shot = Shot(azimuth=azimuth, elevation=elevation)
    if path.suffix == ".png":
        write_png(motion, path, float(motion.times[0]) if time is None else time, shot)
    else:
        write_film(motion, path, shot)


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


def side_by_side(motion: Motion, result: Result, second_result: Motion, second: Result) -> tuple[Motion, Motion]:
    """Return two motions of one mechanism, each with the name of its run and both with one picture."""
    return replace(motion, title=result.title), replace(second_result, title=second.title, picture=motion.picture)


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
