"""A motion as a page, in one call."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mbfmu.errors import UserError
from mbfmu.mechanics import Mechanism
from mbfmu.model import Model, of_user
from mbfmu.native import simulate

from .html import write_html
from .motion import Motion, Recorder


def view(
    model: Model | Mechanism | Motion, path: Path | str = "motion.html", stop_time: float | None = None, **how: Any
) -> Path:
    """Write an animation of a model's motion, one HTML file for any browser, and return its path.

    Parameters
    ----------
    model
        Or a motion that was recorded.
    path
        Of the page.
    stop_time, **how
        As :func:`mbfmu.simulate` takes them.

    Raises
    ------
    UserError
        What :func:`mbfmu.simulate` raises; the run fails at its start; or the file cannot be written.
    """
    path = Path(path)
    if isinstance(model, Motion):
        motion = model
    else:
        recorder, model = Recorder(), of_user(model)
        simulate(model, stop_time, watch=recorder, **how)
        motion = recorder.motion(model.name)
    if not path.parent.is_dir():
        raise UserError(f"folder {str(path.parent)!r} does not exist")
    write_html(motion, path)
    return path
