"""The balance of a run: the energy it has against the energy it started with and the work that was done on it.

    error(t) = E(t) - E(0) - W(t) - sum of jumps

E is kinetic and potential energy, W the work of drives, dampers, given forces and pressures that the solver integrates
with the motion, a jump the change of E at one state where an input or a parameter changes. Along the exact motion the
error is zero; the bound that the tolerance explains is computed by :mod:`solvers.balance`. Once exceeded, it stays
reported: the motion from there on is another one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.util.diagnostics import Diagnostic
from solvers.balance import BALANCE_OK, PASSAGE_INACCURATE

from .run_messages import ENERGY_BALANCE, EXCHANGED_ENERGY_PART, SLOW_PASSAGE, filled

Array = NDArray[np.float64]
Place = tuple[float, Array]  # t, q

NEAR_SINGULAR_RATIO = 0.05  # ratio of singular values of J, scaled by the bodies' inertia, that a message calls near


class EnergyCheck:
    """Describes the first violation of the energy balance of a run, which kernels detect.

    Attributes
    ----------
    found
        Warning with time, size and place of the first violation; empty: there is none.
    """

    def __init__(self, compiled: CompiledMechanism, status: NDArray[Any]) -> None:
        self.compiled, self._status, self._lost = compiled, status, status["lost"]
        self.found: tuple[Diagnostic, ...] = ()
        self._last: Place | None = None

    def describe_state(self, t: float, q: Array) -> None:
        """Describe the violation if it was detected at the time t, s, with positions q (nq,)."""
        if self._is_new:
            last = self._last if self._last is None or len(self._last[1]) == len(q) else None  # joints were locked
            self.found = (self._describe(last, (t, q)),)
        self._last = t, q

    def describe(self, times: Array, q: Array) -> None:
        """Describe the violation if it was detected at one of ``times`` (k,), s, with positions q (k, nq)."""
        if self._is_new:
            i = int(np.searchsorted(times, self._status["lost_at"][0]))
            before = (float(times[i - 1]), q[i - 1]) if i else self._last
            self.found = (self._describe(before, (float(times[i]), q[i])),)
        self._last = float(times[-1]), q[-1].copy()

    @property
    def _is_new(self) -> bool:
        """Whether a violation was detected that is not described yet."""
        return self._lost[0] != BALANCE_OK and not self.found

    def _describe(self, before: Place | None, here: Place) -> Diagnostic:
        """Return the warning about a violation here; ``before`` is the last state without one, if there is any."""
        status = self._status[0]
        energy_error, passage, exchanged = (float(status[name]) for name in ("energy_error", "passage", "exchanged"))
        values: dict[str, Any] = {
            "t": here[0],
            "change": abs(energy_error),
            "direction": "more" if energy_error > 0.0 else "less",
        }
        if status["lost"] == PASSAGE_INACCURATE:
            values |= {"part": abs(energy_error) / passage, "passage": passage}
            return filled(SLOW_PASSAGE, time=here[0], **values)
        is_part = exchanged > abs(energy_error)  # else a ratio means nothing: hardly anything has moved before
        part = {"part": abs(energy_error) / exchanged, "exchanged": exchanged} if is_part else {}
        values |= {"part": EXCHANGED_ENERGY_PART.format(**part) if part else ""}
        return filled(ENERGY_BALANCE, time=here[0], **values, nearest=nearest(self.compiled, before or here, here))


def nearest(compiled: CompiledMechanism, before: Place, here: Place) -> str:
    """Return which loops are near a singular configuration somewhere between two positions; empty if none is."""
    if compiled.system.m == 0:
        return ""
    between = (
        (before[0] + s * (here[0] - before[0]), before[1] + s * (here[1] - before[1]))
        for s in np.linspace(0.0, 1.0, 41)
    )
    ratio, rows = min((distance(compiled, t, q) for t, q in between), key=lambda found: found[0])
    if ratio > NEAR_SINGULAR_RATIO:
        return ""
    loops = " and ".join(map(repr, loops_of(compiled, rows)))
    return f"; the loop closed by {loops} is near a singular configuration (ratio of singular values {ratio:.1e})"


def loops_of(compiled: CompiledMechanism, rows: Array) -> tuple[str, ...]:
    """Return the names of the cut joints and couplings whose rows take most part (m,)."""
    names = [name for name, part in zip(compiled.system.constraint_names, rows, strict=True) if part > 0.5 * rows.max()]
    whole = {handle.name for handle in compiled.mechanism.constraints}
    return tuple(dict.fromkeys(name if name in whole else name.rpartition(".")[0] for name in names))


def distance(compiled: CompiledMechanism, t: float, q: Array, rank: int | None = None) -> tuple[float, Array]:
    """Return the smallest singular value of J over the largest, and how much each row takes part in it (m,).

    Redundant constraint equations do not count: all beyond ``rank``, or if that is unknown those that are zero here.
    Singular values are those of J M^-1/2 (of a large tree, where M is not at hand, of J itself), a cut joint's rows in
    units of the longest of them, lengths and angles apart.
    """
    system: Any = compiled.system
    terms = system.allocate_terms()
    system.fill(t, q, np.zeros(system.n), terms)
    moving = system.n_velocities
    J, M = terms.J[:, :moving], terms.M[:moving, :moving]
    if M.size:
        inertia, axes = np.linalg.eigh(M)
        J = J @ axes / np.sqrt(np.maximum(inertia, 1e-12 * inertia[-1]))
    J = J / row_sizes(compiled, np.linalg.norm(J, axis=1))[:, None]
    U, sigma, _ = np.linalg.svd(J, full_matrices=False)
    last = (int(np.sum(sigma > 1e-12 * sigma[0])) if rank is None else rank) - 1
    part, U = np.abs(U[:, last]), U[:, : last + 1]
    tied = np.abs(np.eye(len(U)) - U @ U.T) @ part  # rows that depend on those that take part do so too
    return float(sigma[last] / sigma[0]), np.maximum(part, tied)


def row_sizes(compiled: CompiledMechanism, lengths: Array) -> Array:
    """Return for every row of J the largest of ``lengths`` (m,) among those of its cut joint and kind, of a coupling
    its own.
    """
    data: Any = compiled.data
    first = np.concatenate((data.arrays.cuts["row"], data.arrays.couplings["row"]))
    kept = np.flatnonzero(data.arrays.kept >= 0)
    owner = np.searchsorted(first, kept, side="right")
    moves = np.zeros(len(data.arrays.kept), bool)
    moves[: len(data.state.rows)] = np.abs(data.state.rows["Ga"][:, :3]).max(axis=1, initial=0.0) > 0.0
    kinds = 2 * owner + moves[kept]
    return np.array([max(lengths[kinds == kind].max(), 1e-300) for kind in kinds])
