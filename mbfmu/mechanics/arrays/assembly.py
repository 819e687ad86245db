"""How a mechanism is put together: where it starts, how its loops are closed, and which rows they have too many."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.checks import with_unit_quaternion
from mbfmu.mechanics.elimination import EliminatedLoops
from mbfmu.mechanics.joints import Section
from mbfmu.mechanics.numbers import array_of
from mbfmu.mechanics.records import Data
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import AssemblyError, UserError
from solvers.compiled.tuple_pointer import pin
from solvers.system import AnySystem, Array

from .closing import (
    MAX_CLOSED_ANGLE,
    CutFrames,
    assemble_positions,
    assemble_velocities,
    check_frames,
    check_inertia,
    fill_frame_angles,
)
from .nonholonomic import check_independent
from .numbering import shares_coordinates, states_of
from .rounded import ROUNDED_ADVICE, joint_axes, loop_path, nearly_parallel
from .rows import MAX_LISTED, dependent_rows, describe, first_of


def free_bodies(mechanism: Mechanism) -> list[Body]:
    """Return the bodies whose joints have free coordinates."""
    return [body for body in mechanism.bodies if body.joint.drive is None and not shares_coordinates(body)]


class Assembly:
    """A mechanism from the start given to the builder to positions with closed loops.

    Parameters
    ----------
    mechanism
        What is put together.
    system
        Its equations.
    data
        Arrays and state of the mechanism; the equations place the bodies in the state.
    vanishing_rows
        Names of constraint equations that no free motion can violate; the system has none of them.
    loops
        The loops of a large system.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        system: AnySystem,
        data: Data,
        vanishing_rows: list[str],
        loops: EliminatedLoops | None = None,
    ) -> None:
        self._mechanism, self._system, self._state, self._vanishing_rows = mechanism, system, data.state, vanishing_rows
        self._loops = loops
        self.frames = CutFrames.of(mechanism.cuts, data.arrays)
        self._frames = pin(self.frames)

    def start_positions(self) -> Array:
        """Return the first free positions (nq,) as given to the builder, loops not closed yet."""
        return start_positions(self._mechanism)

    def start_velocities(self) -> Array:
        """Return the first free velocities (n,) as given to the builder."""
        states = [state.start for _, state in states_of(self._mechanism)]
        return np.concatenate((_gathered(self._mechanism, "rate", "nv", None), states))

    def held(self) -> NDArray[np.bool_]:
        """Return which free velocity coordinates (n,) must be left as they are."""
        return held_coordinates(self._mechanism)

    def given(self) -> Array:
        """Return 1 for the positions and velocities (2, n) of free coordinates for which joints give values, 2 for
        amplitudes of flexible bodies, else 0.
        """
        bodies = free_bodies(self._mechanism)
        return np.array(
            [
                np.concatenate(
                    [
                        *(np.full(b.joint.nv, _rank_of_start(b, what)) for b in bodies),
                        np.zeros(self._system.n_states),
                    ]
                )
                for what in ("start", "rate")
            ]
        )

    def assemble(self, t: float) -> tuple[Array, Array]:
        """Close the loops from the start given to the builder; return consistent (q, v).

        Raises
        ------
        AssemblyError
            A loop cannot be closed (with its name and the residual), or a free motion has no inertia.
        """
        held, given = self.held(), self.given()
        q = self.close(t, self.start_positions(), held, given)
        if len(self._system.nonholonomic):
            check_independent(self._system, t, q)
        v = assemble_velocities(self._system, t, q, self.start_velocities(), held, given, self._loops)
        check_inertia(self._system, t, q, v)
        return q, v

    def changes(self, q: Array, v: Array, tolerance: float) -> list[Diagnostic]:
        """Return a note on each given start or rate that the assembly has changed by more than ``tolerance``.

        q (nq,) and v (n,) are assembled; the tolerance is relative, in units of the coordinates.
        """
        size, found, moving = self._system.size, [], self._system.n_velocities
        fastest = float(np.abs(v / size)[:moving].max(initial=0.0))
        first, first_v = self.start_positions(), self.start_velocities()
        at, at_v = 0, 0
        for body in free_bodies(self._mechanism):
            joint = body.joint
            own, own_v = slice(at, at + joint.nq), slice(at_v, at_v + joint.nv)
            at, at_v = own.stop, own_v.stop
            unit = size[own_v] if joint.nq == joint.nv else float(size[own_v].min())
            turned = np.abs(first[own] - q[own]) / unit
            if joint.quaternion:  # both signs are the same orientation
                turned[-4:] = np.minimum(turned[-4:], np.abs(first[own] + q[own])[-4:] / unit)
            if joint.start is not None and np.any(turned > tolerance * np.maximum(1.0, np.abs(first[own]) / unit)):
                found.append(_changed("start", body, first[own], q[own]))
            moved = np.abs(first_v[own_v] - v[own_v]) / size[own_v]
            given = float(np.abs(first_v[own_v] / size[own_v]).max(initial=0.0))
            most = max(fastest, given, self._system.rate)
            if joint.rate is not None and np.any(moved > tolerance * most):
                found.append(_changed("rate", body, first_v[own_v], v[own_v]))
        return first_of(found, "given starts and rates are changed")

    def close(self, t: float, start: Array, held: NDArray[np.bool_], given: Array | None = None) -> Array:
        """Return positions (nq,) with closed loops near ``start``; ``held`` coordinates (n,) stay.

        ``given`` (2, n) positions stay if the others can close the loops.

        Raises
        ------
        AssemblyError
            A loop cannot be closed, or would close in the opposite direction; the message names it and the residual.
        """
        cuts = self._mechanism.cuts
        if not self._mechanism.constraints:
            return start.copy()
        self._place(t, start)
        drawn = np.zeros(len(cuts))
        fill_frame_angles(self._frames, self._system.pinned_data, drawn)
        try:
            q = assemble_positions(self._system, t, start, held, given, self._loops)
        except AssemblyError as error:
            if drawn.max(initial=0.0) < MAX_CLOSED_ANGLE:
                axes = self.nearly_parallel()
                if not axes:
                    raise
                raise AssemblyError(
                    f"{error}; {axes}: if they are intended to be parallel, {ROUNDED_ADVICE}"
                ) from error
            worst = int(np.argmax(drawn))
            raise AssemblyError(
                f"{error}; in the start positions the frames of cut joint {cuts[worst].name!r} are rotated by "
                f"{np.degrees(drawn[worst]):.0f} deg from each other"
            ) from error
        self.check_frames(t, q, drawn)
        return q

    def check_frames(self, t: float, q: Array, drawn: Array | None = None) -> None:
        """Raise AssemblyError where the frames of a cut joint are closed, but the wrong way round.

        ``drawn`` are the angles between them, rad, in the position the loops were closed from.
        """
        self._place(t, q)
        check_frames(self._mechanism.cuts, self._frames, self._system.pinned_data, drawn)

    def nearly_parallel(self) -> str:
        """Say which axes of loops are nearly parallel and most off, where the bodies are; empty: none is so."""
        mechanism, known = self._mechanism, joint_axes(self._mechanism, self._state)
        paths = ((handle, loop_path(mechanism, handle)) for handle in mechanism.cuts)
        texts = (nearly_parallel(mechanism, self._state, handle, path, known) for handle, path in paths)
        return " and ".join([text for text in texts if text][:MAX_LISTED])

    def explain_lock(self, t: float, q: Array, locked: list[Diagnostic]) -> list[Diagnostic]:
        """Return why nothing can move about q (nq,), where constraints leave no freedom: because of what is ``locked``,
        or of axes that are nearly parallel; empty: joints are driven, or no coordinate is free.
        """
        s, driven = self._system, any(body.joint.drive is not None for body in self._mechanism.bodies)
        if not s.m or not s.n or driven:
            return []
        rows = "1 constraint equation leaves" if s.m == 1 else f"{s.m} constraint equations leave"
        text = f"the mechanism cannot move: {rows} no degree of freedom of its {s.n_velocities} joint coordinates"
        if locked:
            remedy = ". ".join((locked[0].remedy, *(other.message for other in locked[1:])))
            return [replace(locked[0], text=f"{text}: {locked[0].text}", remedy=remedy)]
        self._place(t, q)
        if axes := self.nearly_parallel():
            text, remedy = f"{text}: {axes}", f"If they are intended to be parallel, {ROUNDED_ADVICE}"
        else:
            remedy = "Check the joints of its loops, or drive a joint if no motion is intended"
        return [Diagnostic.warning("locked-mechanism", text, remedy)]

    def _place(self, t: float, q: Array) -> None:
        self._system.fill_position(t, q, self._system.allocate_terms())

    def find_redundant(self, t: float, q: Array) -> NDArray[np.int64]:
        """Return the numbers of the constraint equations that depend on the others at closed q (nq,), in order."""
        return dependent_rows(self._system, t, q) if self._loops is None else self._loops.find_redundant(t, q)

    def nearby(self, t: float, q: Array) -> Array:
        """Return a closed position near q (nq,) off singular ones, where the fewest rows depend on others; or q.

        One coordinate is held at its changed value: otherwise projection would return to the singular configuration.
        """
        s = self._system
        best, random, fewest = q, np.random.default_rng(1), len(self.find_redundant(t, q))
        for moved in random.permutation(s.n_velocities)[:4]:
            near = q.copy()
            s.apply(near, s.size * random.uniform(0.02, 0.05, s.n) * random.choice((-1.0, 1.0), s.n))
            try:
                near = self.close(t, near, np.arange(s.n) == moved)
            except AssemblyError:
                continue
            count = len(self.find_redundant(t, near))
            if count <= fewest:
                best, fewest = near, count
        return best

    def notes(self, t: float, q: Array) -> list[Diagnostic]:
        """Return notes on trivially satisfied and on redundant constraint equations at q (nq,), and on a singular
        configuration there.
        """
        names, dependent = self._system.constraint_names, self.find_redundant(t, q)
        redundant = self.find_redundant(t, self.nearby(t, q)) if len(dependent) else dependent
        found = [*self._mechanism.tree_notes]
        found += describe(self._mechanism.constraints, self._vanishing_rows, [names[i] for i in redundant])
        lost = len(dependent) - len(redundant)
        if lost > 0:
            more = "1 more constraint equation depends" if lost == 1 else f"{lost} more constraint equations depend"
            text = f"the start is a singular configuration: {more} on the others there"
            found.append(Diagnostic.note("singular-start", text, time=t))
        return found


def _changed(what: str, body: Body, given: Array, found: Array) -> Diagnostic:
    """Return a note on a given start position or velocity (k,) that the assembly has changed."""
    before, after = (", ".join(f"{x:.6g}" for x in values) for values in (given, found))
    if len(given) == 1:
        size = f" {body.joint.units[0]}{'/s' if what == 'rate' else ''}"
    else:
        size = f" (largest change {np.abs(found - given).max():.2g})"
    owner = f"joint {body.joint_name!r}" if body.joint_name else f"body {body.name!r}"
    return Diagnostic.note(
        "changed-start",
        f"{what} of {owner} is changed from {before} to {after}{size}, because the loops cannot close with "
        "all given values",
        "Give consistent values, or declare as fixed the start values that must be kept",
        subject=body.coordinate_name,
    )


def _rank_of_start(body: Body, what: str) -> float:
    """Return 1 if a joint gives its ``start`` or ``rate``, 2 for the modes of a flexible body, else 0."""
    return 2.0 if isinstance(body.joint, Section) else float(getattr(body.joint, what) is not None)


def start_positions(mechanism: Mechanism) -> Array:
    """Return the first free positions (nq,) as given to the builder, loops not closed yet."""
    return _gathered(mechanism, "start", "nq", "rest")


def held_coordinates(mechanism: Mechanism) -> NDArray[np.bool_]:
    """Return which free velocity coordinates (n,) must be left as they are."""
    parts = [np.full(body.joint.nv, body.joint.fixed) for body in free_bodies(mechanism)]
    states = np.zeros(len(list(states_of(mechanism))), bool)
    return np.concatenate([*parts, states])


def _gathered(mechanism: Mechanism, attribute: str, count: str, default: str | None) -> Array:
    parts = [np.zeros(0)]
    for body in free_bodies(mechanism):
        joint = body.joint
        given = getattr(joint, attribute)
        if given is None:
            parts.append(getattr(joint, default)() if default else np.zeros(getattr(joint, count)))
            continue
        value = np.atleast_1d(array_of(f"{attribute} of body {body.name!r}", given))
        if value.shape != (getattr(joint, count),) or not np.all(np.isfinite(value)):
            raise UserError(
                f"{attribute} of body {body.name!r} is {given!r}; it needs {getattr(joint, count)} finite numbers"
            )
        if attribute == "start" and joint.quaternion:
            value = with_unit_quaternion(body.name, value)
        parts.append(value)
    return np.concatenate(parts)
