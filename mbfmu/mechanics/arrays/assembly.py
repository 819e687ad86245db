"""How a mechanism is put together: where it starts, how its loops are closed, and which rows they have too many."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import AssemblyError, UserError
from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.checks import with_unit_quaternion
from mbfmu.mechanics.numbers import array_of
from mbfmu.mechanics.records import State
from solvers.system import AnySystem, Array

from .closing import assemble_positions, assemble_velocities, check_frames, check_inertia, frame_angles
from .compile import shared
from .rows import dependent_rows, describe


def free_bodies(mechanism: Mechanism) -> list[Body]:
    """Return the bodies whose joints have free coordinates of their own."""
    return [body for body in mechanism.bodies if body.joint.drive is None and not shared(body)]


class Assembly:
    """A mechanism from the start given to the builder to positions with closed loops.

    Parameters
    ----------
    mechanism
        What is put together.
    system
        Its equations.
    state
        Where they place the bodies.
    vanishing_rows
        Names of rows of constraints that no free motion works against; the system has none of them.
    """

    def __init__(self, mechanism: Mechanism, system: AnySystem, state: State, vanishing_rows: list[str]) -> None:
        self._mechanism, self._system, self._state, self._vanishing_rows = mechanism, system, state, vanishing_rows

    def start_positions(self) -> Array:
        """Return the first free positions (nq,) as given to the builder, loops not closed yet."""
        return start_positions(self._mechanism)

    def start_velocities(self) -> Array:
        """Return the first free velocities (n,) as given to the builder."""
        return _gathered(self._mechanism, "rate", "nv", None)

    def held(self) -> NDArray[np.bool_]:
        """Return which free velocity coordinates (n,) must be left as they are."""
        parts = [np.full(body.joint.nv, body.joint.fixed) for body in free_bodies(self._mechanism)]
        return np.concatenate([np.zeros(0, bool), *parts])

    def assemble(self, t: float) -> tuple[Array, Array]:
        """Close the loops from the start given to the builder; return consistent (q, v).

        Raises
        ------
        AssemblyError
            A loop cannot close (says which and by how much), or a free motion has no inertia.
        """
        q = self.close(t, self.start_positions(), self.held())
        v = assemble_velocities(self._system, t, q, self.start_velocities(), self.held())
        check_inertia(self._system, t, q, v)
        return q, v

    def close(self, t: float, start: Array, held: NDArray[np.bool_]) -> Array:
        """Return positions (nq,) with closed loops near ``start``; ``held`` coordinates (n,) stay.

        Raises
        ------
        AssemblyError
            A loop cannot close, or closes the wrong way round; says which and by how much.
        """
        cuts = self._mechanism.cuts
        if not self._mechanism.constraints:
            return start.copy()
        self._place(t, start)
        drawn = frame_angles(cuts, self._state)
        try:
            q = assemble_positions(self._system, t, start, held)
        except AssemblyError as error:
            if drawn.max(initial=0.0) < 1.0:  # rad
                raise
            worst = int(np.argmax(drawn))
            raise AssemblyError(
                f"{error}; the frames of cut joint {cuts[worst].name!r} are drawn "
                f"{np.degrees(drawn[worst]):.0f} deg apart"
            ) from error
        self.check_frames(t, q, drawn)
        return q

    def check_frames(self, t: float, q: Array, drawn: Array | None = None) -> None:
        """Raise AssemblyError where the frames of a cut joint are closed, but the wrong way round.

        ``drawn`` are the angles between them, rad, in the position the loops were closed from.
        """
        self._place(t, q)
        check_frames(self._mechanism.cuts, self._state, drawn)

    def _place(self, t: float, q: Array) -> None:
        self._system.fill_position(t, q, self._system.allocate_terms())

    def beside(self, t: float, q: Array) -> Array:
        """Return a closed position near q (nq,) off singular ones, where the fewest rows depend on others; or q.

        One coordinate is held where it was moved to: closing would lead back to a singular position else.
        """
        s = self._system
        best, random, fewest = q, np.random.default_rng(1), len(dependent_rows(s, t, q))
        for moved in random.permutation(s.n)[:4]:
            near = q.copy()
            s.apply(near, s.size * random.uniform(0.02, 0.05, s.n) * random.choice((-1.0, 1.0), s.n))
            try:
                near = self.close(t, near, np.arange(s.n) == moved)
            except AssemblyError:
                continue
            count = len(dependent_rows(s, t, near))
            if count <= fewest:
                best, fewest = near, count
        return best

    def notes(self, t: float, q: Array) -> list[str]:
        """Return in sentences which rows of the constraints vanish and which are redundant about q (nq,)."""
        names = self._system.constraint_names
        redundant = dependent_rows(self._system, t, self.beside(t, q))
        lines = describe(self._mechanism.constraints, self._vanishing_rows, [names[i] for i in redundant])
        lost = len(dependent_rows(self._system, t, q)) - len(redundant)
        if lost > 0:
            rows = "1 more row depends" if lost == 1 else f"{lost} more rows depend"
            lines.append(f"a singular position: {rows} on the others there")
        return lines


def start_positions(mechanism: Mechanism) -> Array:
    """Return the first free positions (nq,) as given to the builder, loops not closed yet."""
    return _gathered(mechanism, "start", "nq", "rest")


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
