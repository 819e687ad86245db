"""Files of reduced bodies (``.npz``): written whole or not at all, and checked when they are read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.util.array_files import read_arrays, write_arrays
from mbfmu.util.errors import UserError

from .invariants import Invariants

Array = NDArray[np.float64]

FORMAT, VERSION = "mbfmu flexible body", 1
REQUIRED_TEXTS = ("names", "frame")
OPTIONAL_ARRAYS = {"triangles": np.int64, "stress_shapes": np.float64}  # of bodies of meshes


def write_body(path: Path, texts: dict[str, str], names: list[str], arrays: dict[str, Any]) -> None:
    """Write texts, names of interfaces and arrays of a body; the previous file stays if this fails."""
    write_arrays(path, {"format": FORMAT, "version": VERSION, "names": names, **texts, **arrays})


def read_body(path: Path) -> dict[str, Any]:
    """Return the content of a file, checked.

    Raises
    ------
    UserError
        The file cannot be read, is no file of a body, or has another version, arrays of other sizes, or numbers that
        are not finite.
    """
    try:
        found = read_arrays(path)
    except (OSError, ValueError) as error:
        raise UserError(
            f"file {str(path)!r} cannot be read ({error}); allowed: an undamaged file of FlexibleBody.save"
        ) from error
    if str(found.get("format")) != FORMAT:
        raise UserError(f"file {str(path)!r} contains no flexible body; allowed: a file of FlexibleBody.save")
    version = str(found.get("version", "(none)"))
    if version != str(VERSION):
        raise UserError(
            f"file {str(path)!r} has the version {version}; allowed: {VERSION}. Reduce the body again and save it with "
            "this version of mbfmu"
        )
    missing = [name for name in REQUIRED_TEXTS if name not in found]
    if missing:
        raise UserError(f"file {str(path)!r} has no {missing[0]}; allowed: an undamaged file of FlexibleBody.save")
    for name, shape in _shapes(found).items():
        own = found.get(name)
        if own is None and name in OPTIONAL_ARRAYS:
            continue
        kind = OPTIONAL_ARRAYS.get(name, np.float64)
        if own is None or own.shape != shape or own.dtype != kind or not np.all(np.isfinite(own)):
            what = "is missing" if own is None else f"has the shape {own.shape} or numbers that are not finite"
            raise UserError(f"array {name!r} of file {str(path)!r} {what}; allowed: finite numbers {shape}")
    triangles = found.get("triangles", np.zeros((0, 3)))
    if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(found["nodes"]):
        raise UserError(f"array 'triangles' of file {str(path)!r} has unknown nodes; allowed: numbers of nodes")
    return found


def _shapes(found: dict[str, Any]) -> dict[str, tuple[int, ...]]:
    """Return the shapes that arrays must have, by the numbers of modes, nodes and interfaces."""
    n, count = np.size(found.get("frequencies", ())), np.shape(found.get("nodes", ()))[0]
    frames = np.size(found.get("names", ()))
    by_mode = {"S1": (3, n), "h1": (3, n), "J1": (6, n), "S0": (3,), "J0": (3, 3), "mass": ()}
    by_pair = {"J2": 6, "C": 3, "G": 3, "H": 3}
    return {
        "com": (3,),
        "inertia": (3, 3),
        "frequencies": (n,),
        "damping": (n,),
        "modal_masses": (n,),
        "nodes": (count, 3),
        "shapes": (count, 3, n),
        "triangles": (len(found.get("triangles", ())), 3),
        "stress_shapes": (count, 6, n),
        "at": (frames, 3),
        "motion": (frames, 6, n),
        "shortening": (frames, 6, n, n),
        "stiffening": (),
        **by_mode,
        **{name: (rows, n, n) for name, rows in by_pair.items()},
    }


def invariants_of(found: dict[str, Any]) -> Invariants:
    """Return the integrals of the inertia in a file."""
    return Invariants(float(found["mass"]), *(found[name] for name in Invariants._fields[1:]))
