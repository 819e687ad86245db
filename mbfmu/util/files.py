"""Files that users name: one that is there is replaced by a whole one, or stays as it was.

Every file of results is written through :func:`replacing`. An interrupted command, a full disk or a crash of the
machine leaves the previous content.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import report_write_errors

MAX_SUFFIX_LENGTH = 12  # characters of a file's ending that the temporary file keeps; writers choose formats by it


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Yield the path of a new file, which takes the place of ``path`` when the block ends without an exception.

    The new file is in the same folder. Its content is on the disk before it is renamed. Permissions of a file that is
    replaced are kept, and a symbolic link continues to point to the file. What is no regular file, such as
    ``/dev/null`` or a pipe, is written in place.

    Parameters
    ----------
    path
        The file that is to be written; its folder exists.

    Raises
    ------
    UserError
        The file cannot be written.
    """
    path = Path(path)
    with report_write_errors(path):
        target = Path(os.path.realpath(path))
        exists = os.path.lexists(target)
        if exists and not target.is_file():
            yield path
            return
        if exists and not os.access(target, os.W_OK):  # renaming would not ask for it
            raise PermissionError(13, "it is write-protected", str(path))
        suffix = path.suffix if len(path.suffix) <= MAX_SUFFIX_LENGTH else ""
        unfinished = target.with_name(f".unfinished-{secrets.token_hex(4)}{suffix}")
        try:
            yield unfinished
            if exists:
                shutil.copymode(target, unfinished)
            _flush_to_disk(unfinished)
            unfinished.replace(target)
        except OSError as error:
            if error.filename == str(unfinished):
                error.filename = str(path)
            raise
        finally:
            with suppress(OSError):  # it is no longer there, or was never made
                unfinished.unlink()
        with suppress(OSError):  # not every file system does that for folders
            _flush_to_disk(target.parent)


def _flush_to_disk(path: Path) -> None:
    """Wait until the content of a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_text(path: Path | str, text: str) -> None:
    """Write a text file in UTF-8; see :func:`replacing`."""
    with replacing(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8", newline="")


def write_bytes(path: Path | str, content: bytes) -> None:
    """Write a file of bytes; see :func:`replacing`."""
    with replacing(path) as unfinished:
        unfinished.write_bytes(content)


def check_writable(path: Path) -> None:
    """Find out whether a file can be written, and leave it as it is; raises UserError where it cannot."""
    with report_write_errors(path):
        target = Path(os.path.realpath(path))
        if target.is_dir():
            raise IsADirectoryError(21, os.strerror(21), str(path))
        if os.path.lexists(target):
            if not os.access(target, os.W_OK):
                raise PermissionError(13, os.strerror(13), str(path))
            if not target.is_file():
                return
        trial = target.with_name(f".unfinished-{secrets.token_hex(4)}")
        trial.touch(exist_ok=False)
        trial.unlink()
