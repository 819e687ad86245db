"""Files of arrays (``.npz``) that mbfmu reads again: written whole or not at all, read without pickled objects."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .files import replacing


def write_arrays(path: Path | str, arrays: Mapping[str, Any]) -> None:
    """Write arrays and texts, compressed.

    Parameters
    ----------
    path
        File; an existing one is replaced when the new one is complete.
    arrays
        Arrays and texts by name.

    Raises
    ------
    UserError
        The file cannot be written.
    """
    with replacing(path) as unfinished, unfinished.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def read_arrays(path: Path | str) -> dict[str, Any]:
    """Return the arrays of a file by name.

    Raises
    ------
    OSError
        The file cannot be opened.
    ValueError
        It is damaged, or contains no arrays.
    """
    with Path(path).open("rb") as opened:
        try:
            with np.load(opened, allow_pickle=False) as file:
                return {key: file[key] for key in file.files}
        except Exception as error:  # a file of another kind, or with a wrong byte, fails in any of these
            raise ValueError(str(error) or type(error).__name__) from error
