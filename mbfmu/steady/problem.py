"""Steady states of a model: positions at which it stays while its drives turn at constant speed, or at rest.

Steps and run-ups of drives and loads have ended, unless a run is to start in the state, see :mod:`.times`.

A cyclic coordinate, on which nothing depends, such as the angle of a free spindle, keeps the rate the model starts it
with, or has the one that a coupling to a drive or to another gives it; every other free coordinate is at rest. If there
is no steady state with the start rates, cyclic coordinates are at rest as well.

Newton alone from the model's start; where that fails, pseudo-transient continuation first; where that fails,
continuation in the drive speed from rest. What is found is checked: it must hold at every position of the drives, with
closed loops that stay closed.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.arrays.closing import assemble_velocities, least_change
from mbfmu.mechanics.numbers import finite
from mbfmu.modeling.model import Model
from mbfmu.steady.checks import STEADY_TOLERANCE, check
from mbfmu.steady.cyclic import CYCLIC_TOLERANCE, find_cyclic
from mbfmu.steady.messages import describe_dropped_rates, describe_failure, describe_held_states, describe_mesh
from mbfmu.steady.periodic import PeriodicLinearization, describe_period
from mbfmu.steady.rigid_body_modes import describe_pushed
from mbfmu.steady.sampled import describe_samples
from mbfmu.steady.state import Equilibrium, position_names
from mbfmu.steady.supports import Supports
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import AssemblyError, EquilibriumError, UserError, suggest
from solvers.projection.products import PRODUCT_STEP_SIZE
from solvers.statics.dense import DenseEquilibriumSolver
from solvers.statics.linearized import DenseLinearized, Linearized, TreeLinearized
from solvers.statics.newton import EquilibriumSolver, Outcome, Solution
from solvers.statics.spectrum import Stability
from solvers.statics.states import can_hold, hold_states, let_stick, start_values, with_states_as_positions
from solvers.statics.tree import TreeEquilibriumSolver
from solvers.system import Array

MIN_CONTINUATION_STEP = 1e-3  # of the continuation, relative to the full speed
SAME_STATE_DISTANCE = 1e-6  # states closer than this, in units of the coordinates, are one


class EquilibriumProblem:
    """The equilibrium problem of one model, built once and solved from any number of starts.

    Made by :func:`mbfmu.steady.equilibrium.build_problem`.

    Raises
    ------
    EquilibriumError
        There is nothing to solve for.

    Attributes
    ----------
    supports
        Supports that steps and inputs move.
    keeps_rates
        Whether cyclic coordinates keep their start rates; False: they have the rate 0, or that of a coupling.
    """

    def __init__(self, model: Model, compiled: CompiledMechanism, supports: Supports) -> None:
        self.model, self.compiled, self.supports = model, compiled, supports
        self._names = position_names(compiled)
        self._start, self.keeps_rates = self.start(), True
        self._v, self._cyclic = np.zeros(compiled.system.n), np.zeros(compiled.system.n, bool)
        self._z = compiled.assembly.start_velocities()[compiled.system.n_velocities :]
        self._held: Sequence[str] = ()  # names of first-order states that keep their start values
        self._lay_out()
        if not compiled.system.has_matrices:
            if compiled.system.n_states:
                raise EquilibriumError(
                    "the model has a mesh of elements and first-order states; steady states of such models are found "
                    "with few nodes only. Run the model until it is at rest, or leave out the states"
                )
            data = compiled.data
            self._cyclic = find_cyclic(compiled.system, self._start)
            self._v = self._steady_velocities()
            self._solver: EquilibriumSolver = TreeEquilibriumSolver(compiled.system, self._v, bool(self._cyclic.any()))
            self._solver.run_trial(self._start)
        else:
            self._complex = compiled.complex_system()
            data = self._complex.data
            general = compiled.assembly.nearby(0.0, self._start)
            self._cyclic = self._find_cyclic(general)
            self._v = self._steady_velocities()
            self._extended, at = with_states_as_positions(self._complex, 0.0, general, self._z)
            self._hold_states()
            self._solver = DenseEquilibriumSolver(self._extended, 0.0, at, self._v, compiled.system.n_states)
            self._solver.run_trial(self._with_states(self._start))
            supports.add_complex_copy(data.arrays, compiled.signals(data))
        self.signals = compiled.signals(data)
        self._full_speeds = compiled.drives.full_speeds()

    def start(self, given: Mapping[str, float] | None = None) -> Array:
        """Return closed positions (nq,): the model's start with coordinates ``given`` by name instead, held.

        Raises
        ------
        UserError
            No such coordinate, or the loops cannot be closed, or a sheet is folded there.
        """
        q, held = self.compiled.assembly.start_positions(), self.compiled.assembly.held()
        if not isinstance(given or {}, Mapping):
            raise UserError(f"start is {given!r}; allowed: positions by the names of coordinates")
        for name, value in (given or {}).items():
            if name not in self._names:
                raise UserError(
                    f"model {self.model.name!r} has no coordinate {name!r}{suggest(str(name), self._names)}"
                )
            q[self._names.index(name)] = finite(f"start of coordinate {name!r}", value)
        if given:
            held[:] = [name in given for name in self.compiled.system.coordinate_names]
        q = self.compiled.assembly.close(0.0, q, held)
        self.compiled.check_positions(0.0, q)
        return q

    def set_input(self, index: int, value: float) -> None:
        """Let an input have another value, here and in the complex twin."""
        compiled, dense = self.compiled, self.compiled.system.has_matrices
        compiled.inputs.start(index, value)
        if dense:
            place, k = compiled.inputs.places(self._complex.data.arrays, self.signals)[index]
            place[k] = value * compiled.inputs.scale(index)
        self._full_speeds = compiled.drives.full_speeds()
        self._set_velocities()

    def set_keeps_rates(self, keeps_rates: bool) -> None:
        """Let cyclic coordinates keep their start rates, or have the rate 0."""
        self.keeps_rates = keeps_rates
        self._set_velocities()

    def linearized(self) -> Linearized:
        """Return the equations as paths take them, with the inputs as they are at any time."""
        if isinstance(self._solver, DenseEquilibriumSolver):
            return DenseLinearized(self._solver)
        return TreeLinearized(self.compiled.system, self._v)

    def unknowns(self, found: Equilibrium) -> Array:
        """Return the unknowns of a state as paths take them: positions, and the values of first-order states."""
        return np.concatenate((found.q, found.v[found.compiled.system.n_velocities :]))

    def _with_states(self, q: Array) -> Array:
        """Return positions (nq,) with the start values of first-order states, or what has states already."""
        return q if len(q) > self.compiled.system.nq else np.concatenate((q, self._z))

    def state(self, q: Array, lam: Array, found_from: str) -> Equilibrium:
        """Return what else found, by the multipliers of the independent rows; EquilibriumError where it is no state."""
        full = np.zeros(self.compiled.system.m)
        full[self._solver.rows] = lam
        forces, gaps = self._solver.residual(0.0, q, full)
        solution = Solution(outcome=Outcome.FOUND, q=q, lam=full, iterations=0, forces=forces, gaps=gaps)
        return self._checked(solution, found_from, 0.0, continued=True)

    def scattered(self, count: int) -> Iterator[Array]:
        """Yield up to ``count`` closed starts spread over the coordinates, the same in every run."""
        system = self.compiled.system
        random, free = np.random.default_rng(0), np.zeros(system.n, bool)
        far = 2.0 * system.size  # the errors of a chain add up, so do starts
        for _ in range(count):
            q = self._start.copy()
            system.apply(q, far * random.uniform(-1.0, 1.0, system.n))
            try:
                yield self.compiled.assembly.close(0.0, q, free)
            except AssemblyError:
                continue

    def _find_cyclic(self, q: Array) -> NDArray[np.bool_]:
        """Return the coordinates (n,) on which the equations of motion do not depend, at positions q (nq,)."""
        system, n = self._complex, self.compiled.system.n
        v, terms = np.random.default_rng(2).uniform(-1.0, 1.0, n).astype(complex), system.allocate_terms(complex)
        cyclic = np.zeros(n, bool)
        for k in range(n):
            changed = q.astype(complex)
            system.apply(changed, PRODUCT_STEP_SIZE * 1j * np.eye(n)[k])
            system.fill(0.0, changed, v, terms)
            parts = (terms.M, terms.h, terms.J, terms.nu, terms.gamma)
            change = [np.abs(x.imag).max(initial=0.0) / (1.0 + np.abs(x.real).max(initial=0.0)) for x in parts]
            cyclic[k] = max(change) <= CYCLIC_TOLERANCE * PRODUCT_STEP_SIZE
        cyclic[system.n_velocities :] = False
        return cyclic

    def _steady_velocities(self) -> Array:
        """Return the velocities (n,) of the steady motion: those of cyclic coordinates, as the couplings want them."""
        compiled, system = self.compiled, self.compiled.system
        assembly = compiled.assembly
        v = np.where(self._cyclic & self.keeps_rates, assembly.start_velocities(), 0.0)
        if len(system.nonholonomic) and self._cyclic.any():  # rates that are not given follow from those that are
            held = ~self._cyclic | (self.keeps_rates & (assembly.held() | (assembly.given()[1] > 0.0)))
            with suppress(AssemblyError):  # they fit elsewhere
                v = assemble_velocities(system, 0.0, self._start, v, held)
            return v
        if compiled.mechanism.couplings and self._cyclic.any():
            terms = system.allocate_terms()
            system.fill(0.0, self._start, v, terms)
            held, opening = ~self._cyclic | (self.keeps_rates & assembly.held()), terms.J @ v - terms.nu
            v -= system.size * least_change(system, terms.J, opening / system.row_size, held)
        return v

    def solve(
        self,
        q: Array | None = None,
        found_from: str = "the model's start",
        lam: Array | None = None,
        *,
        pseudo_transient: bool = False,
        stick: bool = False,
    ) -> Equilibrium:
        """Find a steady state from closed positions q (nq,).

        ``pseudo_transient`` leaves out trying Newton alone, ``stick`` allows a state that friction holds at q.

        Raises
        ------
        EquilibriumError
            None is found, or what is found is none; with the residual.
        """
        q = self._with_states(self._start if q is None else q)
        if self._solver.is_singular(0.0, q):
            forces, _ = self._solver.residual(0.0, q, np.zeros(self.compiled.system.m))
            raise EquilibriumError(
                f"the start of {self.model.name!r} is a singular configuration: the constraints lose rank, so "
                f"that their forces are not determined (residual {np.abs(forces).max():.3g} N or N m without "
                "them); "
                "give another start (--from)"
            )
        begin = time.perf_counter()
        tried = 0
        if not pseudo_transient:
            solution = self._solver.solve(0.0, q, lam)
            tried, pseudo_transient = solution.iterations, solution.outcome is not Outcome.FOUND
        alone = not pseudo_transient
        if pseudo_transient:
            solution = self._solver.solve(0.0, q, pseudo_transient=True)
            solution = replace(solution, iterations=tried + solution.iterations)
            if stick and self._held and solution.outcome is not Outcome.FOUND:
                found = self._held_by_friction(q, begin, found_from)
                if found is not None:
                    return found
            found_from += ", by pseudo-transient continuation"
        if solution.outcome is not Outcome.FOUND:
            solution, found_from = self._continue_from_rest(q, solution), "rest, by continuation in the drive speed"
        elapsed = time.perf_counter() - begin
        return self._checked(solution, found_from, elapsed, continued=not alone)

    def _held_by_friction(self, q: Array, begin: float, found_from: str) -> Equilibrium | None:
        """Return the state in which frictions without slip stick at q* = (q, z); None: they cannot hold it."""
        n, nq = self.compiled.system.n_velocities, self.compiled.system.nq
        at = self._complex, 0.0, q[:nq], self._v
        with let_stick(self._extended, *at):
            solution = self._solver.solve(0.0, q)
            v = np.concatenate((self._v[:n], solution.q[nq:]))
            if solution.outcome is not Outcome.FOUND or not can_hold(self._extended, *at[:2], solution.q[:nq], v):
                return None
            elapsed = time.perf_counter() - begin
            return self._checked(solution, found_from, elapsed, continued=True, sticks=True)

    def _checked(
        self, solution: Solution, found_from: str, elapsed: float, *, continued: bool, sticks: bool = False
    ) -> Equilibrium:
        """Return what was found, if it is a steady state."""
        check(self.model.name, self.compiled, self._solver, self._v, solution, lasts=self.supports.finishes)
        q, z = np.split(solution.q, [self.compiled.system.nq])
        v = np.concatenate((self._v[: self.compiled.system.n - len(z)], z))
        periodic = PeriodicLinearization(self.compiled, q, v, solution.lam, self._solver.rows).changes()
        found = Equilibrium(
            model=self.model,
            compiled=self.compiled,
            q=q,
            v=v,
            lam=solution.lam,
            rows=self._solver.rows,
            iterations=solution.iterations,
            residual=float(np.abs(solution.forces).max()),
            solve_time=elapsed,
            found_from=found_from,
            continued=continued,
            diagnostics=(
                *describe_held_states(self._held, sticks=sticks),
                *describe_samples(self.compiled),
                *describe_dropped_rates(self.compiled, self._v, self._cyclic & (not self.keeps_rates)),
                *self.compiled.coincident(0.0, q),
                *self.compiled.describe_assumed_length(),
                *([describe_period(self.compiled)] if periodic else ()),
                *describe_mesh(self.compiled, q),
            ),
            periodic=periodic,
            cyclic=self._cyclic,
        )
        return replace(found, diagnostics=(*found.diagnostics, *self._describe_family(found)))

    def _describe_family(self, found: Equilibrium) -> tuple[Diagnostic, ...]:
        """Return a note if a state has others next to it, cyclic coordinates aside."""
        if not isinstance(self._solver, DenseEquilibriumSolver):
            return ()
        at, coordinates = self.unknowns(found), np.flatnonzero(~self._cyclic)
        count = self._solver.count_null_directions(at, found.lam, coordinates)
        with suppress(EquilibriumError):
            if count and bool((found.spectrum.values == 0.0).any()):  # not only soft
                text = f"neutral family: {count} direction{'s' * (count > 1)} in which nothing changes"
                return (Diagnostic.note("steady-state", text),)
        return ()

    def _set_speed(self, part: float) -> None:
        """Let every drive run at ``part`` of its speed."""
        self.compiled.drives.run_at(part * self._full_speeds, self.signals)
        self._set_velocities()

    def _set_velocities(self) -> None:
        """Take the velocities of the steady motion for the speeds of the drives."""
        if self._cyclic.any():
            self._v = self._steady_velocities()
            self._solver.set_velocities(self._v)
        self._hold_states()

    def _hold_states(self) -> None:
        """Let the bristles of frictions without slip keep their start values."""
        system = self.compiled.system
        if system.n_states and system.has_matrices:
            hold_states(self._extended, self._complex, 0.0, self._start, self._v)
            self._z = start_values(self._extended, self._complex, 0.0, self._start, self._v)
            states = zip(system.coordinate_names[system.n_velocities :], self._extended.data.is_held, strict=True)
            self._held = [name for name, is_held in states if is_held]

    def _continue_from_rest(self, q: Array, failed: Solution) -> Solution:
        """Follow the steady state from rest to full speed."""
        if not any(speed for _, speed, _ in self.compiled.drives.speeds()):
            raise EquilibriumError(self._describe_failure(failed, "no equilibrium was found"))
        part, step, iterations = 0.0, 0.25, failed.iterations
        lam: Array | None = None
        try:
            while True:
                self._set_speed(part)
                solution = self._solver.solve(0.0, q, lam, pseudo_transient=lam is None)
                iterations += solution.iterations
                if solution.outcome is Outcome.FOUND:
                    q, lam, reached = solution.q, solution.lam, part
                    if part == 1.0:
                        break
                    step = min(1.5 * step, 1.0 - part)
                elif lam is None:
                    raise EquilibriumError(
                        self._describe_failure(solution, "no steady state was found, nor one at rest")
                    )
                else:
                    step *= 0.5
                    if step < MIN_CONTINUATION_STEP:
                        text = (
                            f"no steady state was found: followed from rest it ends at {reached:.1%} of the drive speed"
                        )
                        raise EquilibriumError(self._describe_failure(solution, text))
                part = min(1.0, reached + step)
        finally:
            self._set_speed(1.0)
        return replace(solution, iterations=iterations)

    def _describe_failure(self, solution: Solution, what: str) -> str:
        """Return why a search failed, see :func:`.describe_failure`."""
        pushed = ""
        if solution.outcome is not Outcome.NOT_FINITE and not self.compiled.system.has_matrices:
            forces, _ = self._solver.residual(0.0, self._start, np.zeros(self.compiled.system.m))
            pushed = describe_pushed(self.compiled, self._start, forces, STEADY_TOLERANCE)
        what = f"{what} for {self.model.name!r}"
        return describe_failure(what, self.compiled, solution, self._v, pushed, self._held)

    def others(self, found: Equilibrium, count: int | None = None) -> list[Equilibrium]:
        """Return further steady states, each once: from scattered starts (24, 4 on a large tree), and where the one
        found is unstable, by continuation from the model's start.
        """
        if count is None:
            count = 4 if not self.compiled.system.has_matrices else 24
        states = [found]
        searches = [(q, "a scattered start", False) for q in self.scattered(count)]
        if count and found.stability is Stability.UNSTABLE:
            searches.insert(0, (self._start, "the model's start", True))
        for q, found_from, pseudo_transient in searches:
            try:
                new = self.solve(q, found_from, pseudo_transient=pseudo_transient)
            except EquilibriumError:
                continue
            if not any(self.same(new.q, old.q) for old in states):
                states.append(new)
        return states[1:]

    def same(self, a: Array, b: Array) -> bool:
        """Whether two positions are one: whole turns of a joint do not count, nor cyclic coordinates."""
        change = self.difference(a, b)
        change[self._plain[0]] /= self.compiled.system.size[self._plain[1]]
        return bool(np.abs(change).max(initial=0.0) < SAME_STATE_DISTANCE)

    def difference(self, a: Array, b: Array) -> Array:
        """Return a - b (nq,): angles within half a turn, quaternions with one sign.

        That of cyclic coordinates, whose position means nothing, is zero.
        """
        change = a - b
        change[self._angles] = (change[self._angles] + np.pi) % (2.0 * np.pi) - np.pi
        change[self._plain[0][self._cyclic[self._plain[1]]]] = 0.0
        for k in self._quaternions:
            e = slice(k, k + 4)
            if a[e] @ b[e] < 0.0:
                change[e] = a[e] + b[e]
        return change

    def _lay_out(self) -> None:
        """Note which positions (nq,) are plain, with the place of their velocities, or angles, or start quaternions."""
        plain: list[tuple[int, int]] = []
        self._angles: list[int] = []
        self._quaternions: list[int] = []
        k = i = 0
        for body in self.compiled.mechanism.bodies:
            joint = body.joint
            if joint.drive is not None or joint.nq == 0:
                continue
            own = joint.nq - 4 * joint.quaternion
            plain += [(k + j, i + j) for j in range(own)]
            self._angles += [k + j for j in range(own) if joint.units[j] == "rad"]
            self._quaternions += [k + own] * joint.quaternion
            k, i = k + joint.nq, i + joint.nv
        self._plain = np.array(plain, np.int64).reshape(-1, 2).T
