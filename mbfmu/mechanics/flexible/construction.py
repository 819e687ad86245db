"""From matrices of a finite element model to the attributes of a flexible body."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypedDict

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.numbers import array_of, is_whole, positive
from mbfmu.util.errors import UserError

from .fe_model import checked_matrices
from .interfaces import CENTER, ties_of
from .invariants import first_moment, invariants
from .reduction import reduce_model
from .stiffening import Stiffening

Array = NDArray[np.float64]

DEFAULT_MODES = 10


class ReductionOptions(TypedDict, total=False):
    """Options of :meth:`.FlexibleBody.from_fe` that the other constructors pass on."""

    modes: int | None
    frequency_limit: float | None
    frame: str
    damping: float | Sequence[float] | Callable[[Array], Array]


class Frame(NamedTuple):
    """Frame of an interface in the frame of the body."""

    at: Array  # (3,) origin, m
    motion: Array  # (6, modes) displacement and rotation by unit amplitudes
    shortening: Array  # (6, modes, modes) Gt and Gr of :mod:`.solid`; zero without geometric stiffening


def reduced_values(
    mass_matrix: Any,
    stiffness_matrix: Any,
    nodes: Any,
    interfaces: Mapping[str, Any],
    geometric_stiffness: Callable[[Array], Any] | None,
    options: ReductionOptions,
) -> dict[str, Any]:
    """Return the attributes of the body; arguments as for :meth:`.FlexibleBody.from_fe`."""
    M, K, X, dof = checked_matrices(mass_matrix, stiffness_matrix, nodes)
    ties = ties_of(interfaces, X, dof)
    names = [tie.name for tie in ties]
    frame = options["frame"] if options["frame"] != "" else names[0]
    if frame not in (CENTER, *names):
        raise UserError(f"frame is {frame!r}; allowed: {', '.join(map(repr, (*names, CENTER)))}")
    if geometric_stiffness is not None and frame == CENTER:
        raise UserError(
            f"frame is {CENTER!r} with geometric stiffening; allowed with it: {', '.join(map(repr, names))}"
        )
    at = names.index(frame) if frame != CENTER else -1
    mass, S, _ = first_moment(M, X, dof)
    center = S / mass
    origin = ties[at].origin if at >= 0 else center
    held = sum(6 if tie.average is not None else dof * len(tie.nodes) for tie in ties)
    count = _mode_count(options["modes"], options["frequency_limit"], M.shape[0] - held)
    stiffens = geometric_stiffness is not None
    reduced = reduce_model(M, K, ties, dof, at, center, extent(X), count, options["frequency_limit"], stiffens)
    stiffness = Stiffening(geometric_stiffness, reduced) if geometric_stiffness is not None else None
    U, n = reduced.shapes, len(reduced.squares)
    found = invariants(M, X - origin, dof, U, stiffness.by_loads if stiffness else None)
    frequencies = np.sqrt(reduced.squares)
    com = found.S0 / mass
    frames = {
        tie.name: Frame(
            tie.origin - origin,
            reduced.frames[k],
            np.array([stiffness.by_wrench(k, j) if k != at else np.zeros((n, n)) for j in range(6)])
            if stiffness
            else np.zeros((6, n, n)),
        )
        for k, tie in enumerate(ties)
    }
    return {
        "frame": frame,
        "mass": mass,
        "com": com,
        "inertia": found.J0 - mass * (com @ com * np.eye(3) - np.outer(com, com)),
        "frequencies": frequencies,
        "damping": _damping(options["damping"], frequencies),
        "nodes": X - origin,
        "shapes": U.reshape(len(X), dof, n)[:, :3],
        "interfaces": frames,
        "stiffening": stiffens,
        "_invariants": found,
        "modal_masses": np.einsum("ik,ik->k", U, M @ U),
    }


def extent(nodes: Array) -> float:
    """Return the largest extent of positions (n, 3) along an axis, m."""
    return float(np.ptp(nodes, axis=0).max())


def _mode_count(modes: int | None, limit: float | None, available: int) -> int | None:
    """Return the number of modes with fixed interfaces; None: by a frequency limit."""
    if limit is not None:
        if modes is not None:
            raise UserError("modes and frequency_limit are given; allowed: one of them")
        positive("frequency_limit", limit)
        return None
    if modes is None:
        return min(DEFAULT_MODES, available)
    if not is_whole(modes) or modes < 0:
        raise UserError(f"modes is {modes!r}; allowed: a whole number, 0 or greater")
    return int(modes)


def _damping(given: Any, frequencies: Array) -> Array:
    ratios = array_of("damping of a flexible body", given(frequencies) if callable(given) else given)
    if ratios.shape not in ((), frequencies.shape) or not np.all(np.isfinite(ratios)) or np.any(ratios < 0.0):
        raise UserError(
            f"damping of a flexible body is {given!r}; allowed: one ratio, or one for each of the {len(frequencies)} "
            "modes, not negative"
        )
    return np.array(np.broadcast_to(ratios, frequencies.shape))
