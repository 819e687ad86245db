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

from mbfmu.mechanics import Plant
from mbfmu.util.codes import coded
from solvers.balance import BALANCE, BALANCE_OK, PASSAGE_INACCURATE, check_energy_balance, energy_floor, find_violation
from solvers.compiled.kernel import records
from solvers.energy_account import EXCHANGED_ENERGY, PASSAGE_ENERGY

Array = NDArray[np.float64]
Place = tuple[float, Array]  # t, q

NEAR_SINGULAR_RATIO = 0.05  # ratio of singular values of J, scaled by the bodies' inertia, that a message calls near


class EnergyCheck:
    """Holds the motion of a plant against its balance.

    Attributes
    ----------
    verdict
        When, by how much and near what the balance was lost; empty while it holds.
    balance
        What kernels know of it: records (1,) of ``solvers.balance.BALANCE``.
    """

    def __init__(self, plant: Plant, tolerance: float, base: float, freedom: int) -> None:
        self.plant, self.verdict, self.balance = plant, "", records(1, BALANCE)
        mass = float(plant.data.arrays.bodies["mass"].sum())
        self.balance["is_checked"], self.balance["reference_energy"], self.balance["tolerance"] = 1, base, tolerance
        self.balance["energy_floor"] = energy_floor(mass, plant.length, plant.system.rate, tolerance)
        driven = any(body.joint.drive is not None for body in plant.mechanism.bodies)
        self.balance["has_one_freedom"] = int(freedom == 1 and not driven)
        self._last: Place | None = None

    @property
    def state(self) -> tuple[float, str, float]:
        """Base (J), verdict, and energy (J) of the last slow passage that was examined, to go back to."""
        return self.base, self.verdict, float(self.balance["last_passage_energy"][0])

    @state.setter
    def state(self, state: tuple[float, str, float]) -> None:
        self.base, self.verdict, self.balance["last_passage_energy"] = state

    @property
    def base(self) -> float:
        """Energy at the start and every jump since, J."""
        return float(self.balance["reference_energy"][0])

    @base.setter
    def base(self, base: float) -> None:
        self.balance["reference_energy"] = base

    def check_state(self, t: float, q: Array, energy: float, energy_account: Array) -> float:
        """Return the energy_error of one state, J; q (nq,), and an energy account (ACCOUNT_SIZE,)."""
        energy_error, kind = check_energy_balance(self.balance, energy, energy_account)
        if kind != BALANCE_OK:
            self._note((t, q), energy_error, kind, energy_account, self._last)
        self._last = t, q
        return float(energy_error)

    def check(self, times: Array, q: Array, energies: Array, energy_accounts: Array) -> Array:
        """Return the energy_error (k,) at ``times`` (k,) with positions q (k, nq), energies and energy accounts (k,
        ACCOUNT_SIZE), J.
        """
        found = np.zeros(len(times))
        i, kind = find_violation(self.balance, np.ascontiguousarray(energies), energy_accounts, found)
        if i < len(times):
            before = (float(times[i - 1]), q[i - 1]) if i else self._last
            self._note((float(times[i]), q[i]), float(found[i]), kind, energy_accounts[i], before)
        if len(times):
            self._last = float(times[-1]), q[-1].copy()
        return found

    def _note(self, here: Place, energy_error: float, kind: int, energy_account: Array, before: Place | None) -> None:
        """Report once that the energy error is too large here; it was not at ``before``."""
        if not self.verdict:
            self.verdict = self._describe(energy_error, kind, energy_account, before or here, here)

    def _describe(self, energy_error: float, kind: int, energy_account: Array, before: Place, here: Place) -> str:
        more = "more" if energy_error > 0.0 else "less"
        change = f"the energy has changed by {abs(energy_error):.3g} J {more} than the work done on the mechanism"
        if kind == PASSAGE_INACCURATE:
            return coded(
                "slow-passage",
                f"the energy error is too large at t = {here[0]:.6g} s: {change}, which is "
                f"{abs(energy_error) / energy_account[PASSAGE_ENERGY]:.2g} of the "
                f"{energy_account[PASSAGE_ENERGY]:.3g} J by which the motion has just passed an unstable "
                "equilibrium, or missed it. The time of the passage and the motion after it may be wrong: reduce "
                "the tolerance and compare the results",
            )
        exchanged = energy_account[EXCHANGED_ENERGY]
        part = (
            f", {abs(energy_error) / exchanged:.2g} of the {exchanged:.3g} J of energy exchanged" if exchanged else ""
        )
        return coded(
            "energy-balance",
            f"the energy error is too large at t = {here[0]:.6g} s: {change}{part}, and more than the tolerance "
            f"explains{nearest(self.plant, before, here)}. The motion after this time may be wrong: reduce the "
            "tolerance or use another solver, and compare the results",
        )


def nearest(plant: Plant, before: Place, here: Place) -> str:
    """Return which loops are near a singular configuration somewhere between two positions; empty if none is."""
    if plant.system.m == 0:
        return ""
    between = (
        (before[0] + s * (here[0] - before[0]), before[1] + s * (here[1] - before[1]))
        for s in np.linspace(0.0, 1.0, 41)
    )
    ratio, rows = min((distance(plant, t, q) for t, q in between), key=lambda found: found[0])
    if ratio > NEAR_SINGULAR_RATIO:
        return ""
    loops = " and ".join(map(repr, loops_of(plant, rows)))
    return f"; the loop closed by {loops} is near a singular configuration (ratio of singular values {ratio:.1e})"


def loops_of(plant: Plant, rows: Array) -> tuple[str, ...]:
    """Return the names of the cut joints and couplings whose rows take most part (m,)."""
    names = [name for name, part in zip(plant.system.constraint_names, rows, strict=True) if part > 0.5 * rows.max()]
    whole = {handle.name for handle in plant.mechanism.constraints}
    return tuple(dict.fromkeys(name if name in whole else name.rpartition(".")[0] for name in names))


def distance(plant: Plant, t: float, q: Array, rank: int | None = None) -> tuple[float, Array]:
    """Return the smallest singular value of J over the largest, and how much each row takes part in it (m,).

    Redundant constraint equations do not count: all beyond ``rank``, or if that is unknown those that are zero here.
    Singular values are those of J M^-1/2 (of a large tree, where M is not at hand, of J itself), a cut joint's rows in
    units of the longest of them, lengths and angles apart.
    """
    system: Any = plant.system
    terms = system.allocate_terms()
    system.fill(t, q, np.zeros(system.n), terms)
    J = terms.J
    if terms.M.size:
        inertia, axes = np.linalg.eigh(terms.M)
        J = J @ axes / np.sqrt(np.maximum(inertia, 1e-12 * inertia[-1]))
    J = J / row_sizes(plant, np.linalg.norm(J, axis=1))[:, None]
    U, sigma, _ = np.linalg.svd(J, full_matrices=False)
    last = (int(np.sum(sigma > 1e-12 * sigma[0])) if rank is None else rank) - 1
    part, U = np.abs(U[:, last]), U[:, : last + 1]
    tied = np.abs(np.eye(len(U)) - U @ U.T) @ part  # rows that depend on those that take part do so too
    return float(sigma[last] / sigma[0]), np.maximum(part, tied)


def row_sizes(plant: Plant, lengths: Array) -> Array:
    """Return for every row of J the largest of ``lengths`` (m,) among those of its cut joint and kind, of a coupling
    its own.
    """
    data: Any = plant.data
    first = np.concatenate((data.arrays.cuts["row"], data.arrays.couplings["row"]))
    kept = np.flatnonzero(data.arrays.kept >= 0)
    owner = np.searchsorted(first, kept, side="right")
    moves = np.zeros(len(data.arrays.kept), bool)
    moves[: len(data.state.rows)] = np.abs(data.state.rows["Ga"][:, :3]).max(axis=1, initial=0.0) > 0.0
    kinds = 2 * owner + moves[kept]
    return np.array([max(lengths[kinds == kind].max(), 1e-300) for kind in kinds])
