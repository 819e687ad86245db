"""Steady states about which the linearized motion has periodic coefficients, as those of a turning rotor that is not
alike about its axis, on springs that do not turn with it.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import reduce
from math import gcd, lcm, pi

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.steady.checks import CHECKED_DRIVE_POSITIONS
from mbfmu.steady.linear import StateSpace, linearize
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import EquilibriumError
from solvers.diagnostics import without_code
from solvers.linalg.threads import one_thread
from solvers.projection.products import Products
from solvers.statics.floquet import characteristic_exponents
from solvers.statics.matrices import MAX_ASSEMBLED_COORDINATES, Matrices, linearized_matrices
from solvers.statics.spectrum import Spectrum
from solvers.system import Array

PERIODIC_TOLERANCE = 1e-8  # of a matrix at another position of the drives, relative, from which on it is periodic
# of speeds that have a common period, and by how much their ratio may be off one
MAX_SPEED_RATIO, SPEED_RATIO_TOLERANCE = 200, 1e-9

PERIODIC_NOTE = (
    "periodic coefficients: the linearized motion changes with the positions of the drives; modes are characteristic "
    "exponents of the monodromy matrix over {period:.6g} s (Floquet), whose frequencies are known but for multiples of "
    "{frequency:.6g} rad/s"
)
UNKNOWN_STABILITY_TEXT = (
    "periodic coefficients: the linearized motion changes with the positions of the drives; {reason}"
)


class PeriodicLinearization:
    """The linearized motion of a compiled mechanism at other positions of its drives.

    Parameters
    ----------
    compiled, q, v, lam, rows
        A steady state (nq,), (n,), (m,), and its independent constraints.
    """

    def __init__(self, compiled: CompiledMechanism, q: Array, v: Array, lam: Array, rows: NDArray[np.int64]) -> None:
        self.compiled, self.q, self.v, self.lam, self.rows = compiled, q, v, lam, rows
        self._system = compiled.complex_system() if compiled.system.has_matrices else compiled.system

    def at(self, t: float) -> tuple[Array, Array]:
        """Return positions (nq,) and multipliers (m,) at time t, when constraints may have turned with the drives."""
        q, lam, system = self.q.copy(), self.lam, self.compiled.system
        system.apply(q, t * self.v)
        if len(self.rows):
            terms = system.allocate_terms()
            system.fill_position(t, q, terms)
            forces = self.compiled.inverse_dynamics(t, q, self.v, np.zeros(system.n), np.zeros(system.m))
            lam = np.zeros(system.m)
            lam[self.rows] = np.linalg.lstsq(terms.J[self.rows].T, -forces, rcond=None)[0]
        return q, lam

    def matrices(self, t: float, basis: Array | None = None) -> Matrices:
        """Return the matrices at time t, over the motions that constraints allow there, or a basis of others."""
        q, lam = self.at(t)
        return linearized_matrices(self._system, t, q, self.v, lam, basis, measured=basis is None)

    def changes(self) -> bool:
        """Whether the linearized motion differs at other positions of the drives."""
        fastest = max(self.compiled.drives.rates(), default=0.0)
        if not fastest:
            return False
        times = [turn / fastest for turn in CHECKED_DRIVE_POSITIONS]
        if not self.compiled.system.has_matrices and self.compiled.system.n > MAX_ASSEMBLED_COORDINATES:
            return self._products_change(times)
        first = self.matrices(0.0)
        stiff = np.sqrt(np.abs(np.diag(first.K)) + first.rate**2 * np.diag(first.M))
        heavy = np.sqrt(np.abs(np.diag(first.M)))
        bounds = (
            PERIODIC_TOLERANCE * np.outer(heavy, heavy),
            first.rounding[1] + PERIODIC_TOLERANCE * (np.outer(stiff, heavy) + np.outer(heavy, stiff)),
            first.rounding[0] + PERIODIC_TOLERANCE * np.outer(stiff, stiff),
        )
        for t in times:
            if self._constraints_turn(t, first.basis):
                return True
            other = self.matrices(t, first.basis)
            pairs = zip((first.M, first.C, first.K), (other.M, other.C, other.K), bounds, strict=True)
            if any((np.abs(A - B) > bound).any() for A, B, bound in pairs):
                return True
        return False

    def _constraints_turn(self, t: float, basis: Array) -> bool:
        """Whether the constraints at time t do not allow the motions of a basis (n, f)."""
        system = self.compiled.system
        if not system.m:
            return False
        terms = system.allocate_terms()
        system.fill_position(t, self.at(t)[0], terms)
        opening = np.abs(terms.J @ basis) / system.row_size[:, np.newaxis]
        return bool(opening.max(initial=0.0) > PERIODIC_TOLERANCE)

    def _products_change(self, times: list[float]) -> bool:
        """Whether products with a random motion differ; of a tree without constraints."""
        system = self.compiled.system
        if system.m:
            return False
        products, random = Products(system), np.random.default_rng(4)
        x = random.normal(size=system.n) * system.size
        found = []
        for t in (0.0, *times):
            products.set_state(t, self.at(t)[0], self.v, np.zeros(system.n), self.lam)
            found.append(np.array([products.apply(x, *which) for which in np.eye(3)]))
        size = np.abs(found[0]).max(axis=1, keepdims=True) + system.rate ** np.array([[2.0], [1.0], [0.0]]) * np.abs(
            found[0][2]
        )
        return any((np.abs(other - found[0]) > PERIODIC_TOLERANCE * size).any() for other in found[1:])

    def spectrum(self) -> Spectrum:
        """Return the characteristic exponents; EquilibriumError where they are not found."""
        period, system = common_period(self.compiled), self.compiled.system
        if system.n_states:
            raise EquilibriumError(
                UNKNOWN_STABILITY_TEXT.format(
                    reason="they are computed for models without first-order states, but the model has state "
                    f"{system.coordinate_names[-1]!r}"
                )
            )
        cycles = period * sum(abs(speed) for _, speed, _ in self.compiled.drives.speeds()) / (2.0 * pi)
        if not system.has_matrices and system.n > MAX_ASSEMBLED_COORDINATES:
            raise EquilibriumError(
                UNKNOWN_STABILITY_TEXT.format(
                    reason=f"they are computed for up to {MAX_ASSEMBLED_COORDINATES} coordinates, but the model has "
                    f"{system.n}"
                )
            )
        with one_thread():
            try:
                if len(self.rows):
                    return self._constrained(period, cycles)
                return characteristic_exponents(self._state_matrix, period, cycles, np.diag(system.size))
            except np.linalg.LinAlgError as reason:
                raise EquilibriumError(
                    UNKNOWN_STABILITY_TEXT.format(reason=f"its exponents were not found: {reason}")
                ) from reason

    def _state_matrix(self, t: float) -> Array:
        """Return A (2n, 2n) of a mechanism without constraints, coordinates in units."""
        found = self.matrices(t, np.diag(self.compiled.system.size))
        n = len(found.M)
        inverse = np.linalg.solve(found.M, np.hstack((found.K, found.C)))
        return np.block([[np.zeros((n, n)), np.eye(n)], [-inverse]])

    def _constrained(self, period: float, cycles: float) -> Spectrum:
        """Return the characteristic exponents by the independent coordinates."""
        first = linearize(self.compiled, 0.0, self.q, self.v, self.rows)
        return characteristic_exponents(lambda t: self._linearized(t, first).free, period, cycles, first.coordinates)

    def _linearized(self, t: float, first: StateSpace) -> StateSpace:
        """Return the state matrices at time t, of the states of the first ones."""
        system, freedom = self.compiled.system, first.coordinates.shape[1]
        numbers = {name: k for k, name in enumerate(system.coordinate_names)}
        numbers |= {f"der({name})": k for name, k in numbers.items()}
        chosen = first.states[:freedom], first.states[freedom : first.n_moving]
        independent = tuple(np.append([numbers[name] for name in own], system.states).astype(int) for own in chosen)
        driven = first.states[first.n_moving + first.n_states :]
        return linearize(self.compiled, t, self.at(t)[0], self.v, self.rows, independent, driven)

    def state_space(self) -> StateSpace:
        """Return the state matrices, and which of them are others at other positions of the drives."""
        first = linearize(self.compiled, 0.0, self.q, self.v, self.rows)
        fastest = max(self.compiled.drives.rates(), default=0.0)
        if not fastest:
            return first
        others = [self._linearized(turn / fastest, first) for turn in CHECKED_DRIVE_POSITIONS]
        changed = []
        for name in "ABCD":
            here = getattr(first, name)
            bound = PERIODIC_TOLERANCE * np.abs(here).max(initial=0.0)
            if any((np.abs(getattr(other, name) - here) > bound).any() for other in others):
                changed.append(name)
        return replace(first, periodic=tuple(changed))


def describe_period(compiled: CompiledMechanism) -> Diagnostic:
    """Return the note on periodic coefficients."""
    try:
        period = common_period(compiled)
    except EquilibriumError as error:
        return Diagnostic.parse(without_code(str(error)), "note", "periodic-coefficients")
    return Diagnostic.note("periodic-coefficients", PERIODIC_NOTE.format(period=period, frequency=2.0 * pi / period))


def common_period(compiled: CompiledMechanism) -> float:
    """Return the time in which all drives come back to where they are, s; EquilibriumError where there is none."""
    units = {body.name: body.joint.units[0] for body in compiled.mechanism.bodies if body.joint.drive is not None}
    moving = [(name, abs(speed)) for name, speed, _ in compiled.drives.speeds() if speed]
    for name, _ in moving:
        if units[name] != "rad":
            raise EquilibriumError(UNKNOWN_STABILITY_TEXT.format(reason=f"the drive of {name!r} is not periodic"))
    fastest = max(speed for _, speed in moving)
    ratios = [Fraction(speed / fastest).limit_denominator(MAX_SPEED_RATIO) for _, speed in moving]
    for (name, speed), ratio in zip(moving, ratios, strict=True):
        if abs(float(ratio) - speed / fastest) > SPEED_RATIO_TOLERANCE:
            raise EquilibriumError(
                UNKNOWN_STABILITY_TEXT.format(
                    reason=f"the speed of {name!r} and the fastest one, {fastest:g} rad/s, have no ratio of whole "
                    f"numbers up to {MAX_SPEED_RATIO}, so there is no period that could be followed"
                )
            )
    below = reduce(lcm, (ratio.denominator for ratio in ratios), 1)
    slowest = reduce(gcd, (int(ratio * below) for ratio in ratios))
    return 2.0 * pi * below / (slowest * fastest)
