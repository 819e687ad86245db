"""Folder of the results of a command: a separate one, to which no other run writes."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

from mbfmu.modeling.scene import Scene
from mbfmu.util.errors import report_write_errors

from .common import file_name, folder


class Results:
    """Files on their way to ``root/model/what``: in a hidden folder next to it until :meth:`keep`.

    So there is no folder with half the files of a run, and two processes that end at once do not meet.
    """

    def __init__(self, root: Path, scene: Scene, what: str) -> None:
        self.place = root / file_name(scene.model.name) / what
        self.new = [path for path in self.place.parents if not path.exists()]  # innermost first
        self.hidden = folder(self.place.parent) / f".unfinished-{secrets.token_hex(6)}"

    def file(self, name: str) -> Path:
        """Return the path to write a file to."""
        return self.hidden / name

    def keep(self, mark: str = "") -> Path:
        """Give the folder its name, followed by ``mark``, or the next number where that is taken; return its path."""
        name = "-".join(filter(None, (self.place.name, mark)))
        for number in count(1):
            target = self.place.with_name(name if number == 1 else f"{name}-{number}")
            if os.path.lexists(target):
                continue
            try:
                self.hidden.rename(target)
            except OSError:
                if os.path.lexists(target):
                    continue  # another process was faster
                raise
            return target
        raise AssertionError  # numbers do not end


@contextmanager
def results(root: Path, scene: Scene, what: str) -> Iterator[Results]:
    """Yield where files may be written; what is not kept is removed, whatever happens.

    Raises
    ------
    UserError
        A folder cannot be made, or a file cannot be written.
    """
    place = Results(root, scene, what)
    with report_write_errors(place.place.parent):
        place.hidden.mkdir(parents=True)
    try:
        with report_write_errors(place.place):
            yield place
    finally:
        shutil.rmtree(place.hidden, ignore_errors=True)
        with suppress(OSError):  # they are not empty
            for path in place.new:
                path.rmdir()
