"""A compiled mechanism at work: what simulation and FMU hold."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf, log10, prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import AssemblyError, UserError
from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.checks import with_unit_quaternion
from mbfmu.mechanics.elements import Plate
from mbfmu.mechanics.kind import Kind
from mbfmu.mechanics.numbers import array_of
from mbfmu.mechanics.records import Data
from mbfmu.mechanics.recursions.dynamics import audit_callbacks, callbacks, energy, observe, observe_all, tree_callbacks
from mbfmu.mechanics.sensors import Follows, largest_residual
from mbfmu.mechanics.signals import InUse
from mbfmu.mechanics.tangent import Groups, Tangent, find_groups
from mbfmu.units import read_unit
from solvers.held import contents
from solvers.system import Array, System, TreeSystem

from .assembly import assemble_positions, assemble_velocities, check_frames, check_inertia, frame_angles
from .bending import Bend, bend
from .compile import Compiled, Numbering, Variable, check_rows, shared
from .inputs import Drives, Inputs
from .rows import Probe, dependent_rows, describe, row_names
from .scale import characteristic_length, coordinate_sizes, row_sizes

LARGE = 60  # coordinates of a tree without loops from which on no dense matrix is made
LARGE_LOOPS = 100  # ... of a mechanism with cut joints; the partitions take its matrices all the same
WIDEST = 1000  # bodies in a group of the structured tangent: its matrix has twelve rows a body


class Plant:
    """A mechanism as arrays, with its inputs, its outputs and the system a solver takes.

    Attributes
    ----------
    system
        The equations of motion over the free coordinates.
    drives, inputs
        What moves and loads the mechanism from outside.
    outputs
        Variables in the order of :meth:`observe`.
    length
        Characteristic length, m; see :func:`.scale.characteristic_length`.
    void_rows
        Names of rows of constraints that no free motion works against; dropped.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        if len(mechanism.bodies) == 1:
            raise UserError("the mechanism has no bodies; add at least one with Mechanism.body")
        mechanism.compiled = True
        self.mechanism = mechanism
        self._numbering = numbering = Numbering(mechanism)
        try:
            self._compiled = compiled = Compiled(mechanism, numbering)
        except MemoryError as error:
            count = len(mechanism.bodies)
            raise UserError(f"a mechanism of {count} bodies needs more memory than there is") from error
        self.data = compiled.data
        self.length = characteristic_length(mechanism, self.data.arrays)
        self._size = coordinate_sizes(self._free_bodies(), self.length)
        names = row_names(mechanism.constraints)
        self.drives = Drives(mechanism, numbering, compiled.signals, self.length)
        self.inputs = Inputs(numbering, self.data.arrays, compiled.signals, self.drives)
        self._row_size = np.concatenate([np.zeros(0), *(row_sizes(c, self.length) for c in mechanism.constraints)])
        self.void_rows: list[str] = []
        large = not mechanism.elastics and numbering.nv > (LARGE_LOOPS if names else LARGE)  # T knows no modes
        make = self._tree_system if large else self._system
        self.system: Any = make(names, self.data)
        if names:
            self.void_rows = self._drop_void_rows(names)
            self.system = make([n for n in names if n not in self.void_rows], self.data)
        self.outputs = tuple(Variable(n, s.unit, d, 0.0, nominal) for n, s, d, nominal in mechanism.outputs)
        check_rows(mechanism, self.data.arrays.kept)

    def feedthrough(self) -> list[tuple[int, ...]]:
        """Return for every output which inputs change it at the moment they are set, by number."""
        return [
            tuple(k for k in range(len(self.inputs)) if self.inputs.changes(k, sensor.follows))
            for _, sensor, *_ in self.mechanism.outputs
        ]

    @property
    def tells_forces(self) -> bool:
        """Whether some output is a force, a moment or an effort."""
        return any(sensor.follows is Follows.FORCES for _, sensor, *_ in self.mechanism.outputs)

    def nominal(self, unit: str) -> float:
        """Return the order of magnitude of what has this unit: of the heaviest body, the length and the pace here."""
        exponents, factor = read_unit(unit)
        mass = float(self.data.arrays.bodies["mass"].max()) or 1.0
        sizes = {"kg": mass, "m": self.length, "s": 1.0 / (self._rate() or 1.0), "rad": 1.0}
        size = prod(sizes[base] ** n for base, n in exponents.items()) / factor
        return 10.0 ** round(log10(size))

    def records(self, kind: type[Kind]) -> NDArray[Any]:
        """Return the records of a kind of joint, cut joint, load, signal or sensor, in the order they were added."""
        return self._compiled.table(kind)

    @property
    def kernel_data(self) -> Any:
        """Arrays and state as kernels take them; see :mod:`solvers.held`."""
        return contents(self.system.held_data)

    def signals(self, data: Data) -> list[InUse]:
        """Return every signal as it is in data of this plant: its own, or those of a complex system."""
        return self._compiled.signals_in(data)

    def complex_system(self) -> System:
        """Return the system as it is now on complex numbers, for derivatives by complex step."""
        return self._system(list(self.system.constraint_names), self._compiled.twin(), complex)

    def _system(self, constraint_names: list[str], data: Data, scalar: type = float) -> System:
        dynamics, position, motion, retract, energy = callbacks(scalar)
        power, exposure = audit_callbacks(tree=False) if scalar is float else (None, None)
        return System(
            nq=self._numbering.nq,
            n=self._numbering.nv,
            m=len(constraint_names),
            data=data,
            dynamics=dynamics,
            position=position,
            motion=motion,
            retract=retract,
            energy=energy,
            size=self._size,
            row_size=self._row_sizes(constraint_names),
            rate=self._rate(),
            loop_rate=self._loop_rate(),
            power=power,
            exposure=exposure,
            works=self._works,
            resolves=self._resolves,
            coordinate_names=tuple(self._numbering.coordinate_names),
            constraint_names=tuple(constraint_names),
        )

    def _tree_system(self, constraint_names: list[str], data: Data) -> TreeSystem:
        """Return the system of a large tree."""
        inverse, forward, mobility, position, constraints, retract = tree_callbacks()
        power, exposure = audit_callbacks(tree=True)
        places: list[tuple[int, int]] = []
        quaternions: list[tuple[int, int]] = []
        for record in self.data.arrays.bodies:
            if record["vf"] < 0:
                continue
            plain = int(record["nq"] - 4 * record["quaternion"])
            places += [(int(record["qf"]) + k, int(record["vf"]) + k) for k in range(plain)]
            if record["quaternion"]:
                quaternions.append((int(record["qf"]) + plain, int(record["vf"]) + plain))
        in_q, in_v = np.array(places, np.int64).reshape(-1, 2).T
        return TreeSystem(
            nq=self._numbering.nq,
            n=self._numbering.nv,
            m=len(constraint_names),
            data=data,
            inverse=inverse,
            forward=forward,
            mobility=mobility,
            position=position,
            constraints=constraints,
            retract=retract,
            tangent=self.tangent(),
            size=self._size,
            row_size=self._row_sizes(constraint_names),
            plain=(in_q, in_v),
            rate=self._rate(),
            quaternions=tuple(quaternions),
            dense=lambda: self._system(constraint_names, data),
            power=power,
            exposure=exposure,
            works=self._works,
            resolves=self._resolves,
            coordinate_names=tuple(self._numbering.coordinate_names),
            constraint_names=tuple(constraint_names),
        )

    def _works(self) -> bool:
        return bool(self.data.arrays.world["works"][0])

    def _resolves(self, t: float) -> tuple[float, float]:
        """Return the longest step from t on that misses no signal, and until when it does not, s."""
        found = [signal.longest_step(t) for signal in self._compiled.signals]
        return min((step for step, _ in found), default=inf), min((until for _, until in found), default=inf)

    def tangent(self, groups: Groups | None = None) -> Tangent:
        """Return the structured tangent at the state of this plant, over these groups of bodies."""
        found = self._groups() if groups is None else groups
        return Tangent(self._compiled.tangent_arrays(), self.data.state, found, list(self.mechanism.loads()))

    def _groups(self) -> Groups:
        """Return the groups of the structured tangent; UserError where they would be too wide to be solved."""
        groups = find_groups(self.mechanism)
        widest = int(np.bincount(groups.of[1:]).argmax())
        members = np.flatnonzero(groups.of == widest)
        if len(members) > WIDEST:
            raise UserError(
                f"joints, forces and elements tie {len(members)} bodies to each other, "
                f"{self.mechanism.bodies[members[-1]].name!r} among them, so that they must be solved at once; "
                f"allowed: {WIDEST}; tie bodies that are near each other in the tree"
            )
        return groups

    def _drop_void_rows(self, names: list[str]) -> list[str]:
        """Find the rows whose Jacobian vanishes wherever the mechanism may be, and number the others anew.

        A few random positions decide, of the free coordinates and of the drives: those that are functions of time
        where they are at some time, those that are inputs anywhere. A row that is not void vanishes there with
        probability zero.

        Raises
        ------
        AssemblyError
            A void row is not closed, or the drives open it.
        """
        signals, probe, start = self._compiled.signals, Probe(self.system), self.start_positions()
        before = self.data.arrays.memory.copy()
        given = [k for k in self.drives.signals if k in self.inputs.signals]
        centers = {k: float(signals[k].record["c"][0]) for k in given}
        paces = [self.drives.pace(k) for k in self.drives.signals if k not in given]
        for scale in (0.0, *(x for x in paces if x), *(1.0 for _ in given)):
            for _ in range(3):
                probe.try_at(scale * probe.turns(), start)
                for k in given:
                    signals[k].record["c"][0] = centers[k] + self.drives.sizes[k] * probe.normal()
        self.data.arrays.memory[:] = before
        void = probe.void([unit for handle in self.mechanism.constraints for unit in handle.units])
        self.data.arrays.kept[:] = np.where(void, -1, np.cumsum(~void) - 1)
        return [names[i] for i in np.flatnonzero(void)]

    def _rate(self, bodies: Iterable[int] | None = None) -> float:
        """Return how fast gravity and drives, or the drives of these bodies, move them, 1/s; zero: neither does."""
        weight = float(np.linalg.norm(self.data.arrays.world["gravity"][0]))
        return max(np.sqrt(weight / self.length), *(1.0 / pace for pace in self.drives.paces(bodies)), 0.0)

    def _loop_rate(self) -> float:
        """Return how fast gravity and the drives that carry a cut joint's bodies or are coupled move them, 1/s."""
        carrying: set[int] = set()
        for body in (end.index for cut in self.mechanism.cuts for end in (cut.a, cut.b)):
            k = body
            while k > 0 and k not in carrying:
                carrying.add(k)
                k = self.mechanism.bodies[k].parent
        carrying.update(end.index for coupling in self.mechanism.couplings for end in (coupling.a, coupling.b))
        return self._rate(carrying)

    def _row_sizes(self, names: list[str]) -> Array:
        """Return the units of the kept rows; before any is dropped, of all."""
        return self._row_size[self.data.arrays.kept >= 0] if names else np.zeros(0)

    def _free_bodies(self) -> list[Body]:
        """Return the bodies whose joints have free coordinates of their own."""
        return [b for b in self.mechanism.bodies if b.joint.drive is None and not shared(b)]

    def start_positions(self) -> Array:
        """Return the first free positions (nq,) as given to the builder, loops not closed yet."""
        return self._gather("start", "nq", "rest")

    def start_velocities(self) -> Array:
        """Return the first free velocities (n,) as given to the builder."""
        return self._gather("rate", "nv", None)

    def _gather(self, attribute: str, count: str, default: str | None) -> Array:
        parts = [np.zeros(0)]
        for body in self._free_bodies():
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

    def held(self) -> NDArray[np.bool_]:
        """Return which free velocity coordinates (n,) assembly must leave as they are."""
        parts = [np.full(b.joint.nv, b.joint.fixed) for b in self._free_bodies()]
        return np.concatenate([np.zeros(0, bool), *parts])

    def assemble(self, t: float = 0.0) -> tuple[Array, Array]:
        """Close the loops from the start given to the builder; return consistent (q, v).

        Raises
        ------
        AssemblyError
            A loop cannot close (says which and by how much), or a free motion has no inertia.
        """
        q = self.close(t, self.start_positions(), self.held())
        v = assemble_velocities(self.system, t, q, self.start_velocities(), self.held())
        check_inertia(self.system, t, q, v)
        return q, v

    def close(self, t: float, start: Array, held: NDArray[np.bool_]) -> Array:
        """Return positions (nq,) with closed loops near ``start``; ``held`` coordinates (n,) stay.

        Raises
        ------
        AssemblyError
            A loop cannot close, or closes the wrong way round; says which and by how much.
        """
        if not self.mechanism.constraints:
            return start.copy()
        self.system.fill_position(t, start, self.system.allocate_terms())
        drawn = frame_angles(self.mechanism.cuts, self.data.state)
        try:
            q = assemble_positions(self.system, t, start, held)
        except AssemblyError as error:
            if drawn.max(initial=0.0) < 1.0:  # rad
                raise
            worst = int(np.argmax(drawn))
            raise AssemblyError(
                f"{error}; the frames of cut joint {self.mechanism.cuts[worst].name!r} are drawn "
                f"{np.degrees(drawn[worst]):.0f} deg apart"
            ) from error
        self.check_frames(t, q, drawn)
        return q

    def check_frames(self, t: float, q: Array, drawn: Array | None = None) -> None:
        """Raise AssemblyError where the frames of a cut joint are closed, but the wrong way round.

        ``drawn`` are the angles between them, rad, in the position the loops were closed from.
        """
        self.system.fill_position(t, q, self.system.allocate_terms())
        check_frames(self.mechanism.cuts, self.data.state, drawn)

    def beside(self, t: float, q: Array) -> Array:
        """Return a closed position near q (nq,) off singular ones, where the fewest rows depend on others; or q.

        One coordinate is held where it was moved to: closing would lead back to a singular position else.
        """
        best, random, n = q, np.random.default_rng(1), self.system.n
        fewest = len(dependent_rows(self.system, t, q))
        for moved in random.permutation(n)[:4]:
            near = q.copy()
            self.system.apply(near, self.system.size * random.uniform(0.02, 0.05, n) * random.choice((-1.0, 1.0), n))
            try:
                near = self.close(t, near, np.arange(n) == moved)
            except AssemblyError:
                continue
            count = len(dependent_rows(self.system, t, near))
            if count <= fewest:
                best, fewest = near, count
        return best

    def loops(self, t: float, q: Array) -> list[str]:
        """Return in sentences which rows of the constraints are void and which are redundant about q (nq,)."""
        names = self.system.constraint_names
        redundant = dependent_rows(self.system, t, self.beside(t, q))
        lines = describe(self.mechanism.constraints, self.void_rows, [names[i] for i in redundant])
        lost = len(dependent_rows(self.system, t, q)) - len(redundant)
        if lost > 0:
            rows = "1 more row depends" if lost == 1 else f"{lost} more rows depend"
            lines.append(f"a singular position: {rows} on the others there")
        return lines

    def cut_wrenches(self, t: float, q: Array, v: Array, lam: Array) -> Array:
        """Return what every cut joint exerts on its bodies a and b (cuts, 2, 6), each in the axes of that body."""
        self.system.fill(t, q, v, self.system.allocate_terms())
        arrays, state = self.data
        rows, load = state.rows, np.where(arrays.kept >= 0, lam[arrays.kept], 0.0)
        found = np.zeros((len(arrays.cuts), 2, 6))
        for wrenches, cut in zip(found, arrays.cuts, strict=True):
            own = slice(int(cut["row"]), int(cut["end"]))
            for wrench, body, G in zip(wrenches, (cut["a"], cut["b"]), (rows["Ga"], rows["Gb"]), strict=True):
                wrench[:] = -(load[own] @ G[own]).reshape(2, 3).dot(state.bodies["A"][int(body)]).ravel()
        return found

    def observe_complex(self, system: System, t: float, q: Any, v: Any, a: Any, lam: Any) -> NDArray[np.complex128]:
        """Return the outputs at a state of :meth:`complex_system`."""
        out = np.zeros(len(self.outputs), complex)
        observe(t, q, v, a, lam, system.held_data, out)
        return out

    def observe(self, t: float, q: Array, v: Array, a: Array, lam: Array, out: Array) -> None:
        """Fill ``out`` (len(outputs),) from the solution: accelerations a (n,), multipliers lam (m,).

        With two entries more its last are the energy and the kinetic energy, J.
        """
        observe(t, q, v, a, lam, self.system.held_data, out)

    def observe_all(self, times: Array, q: Array, v: Array, a: Array, lam: Array, out: Array) -> None:
        """Fill ``out`` (k, len(outputs)), or two columns more, from the solution at k times as :meth:`observe` does."""
        observe_all(times, q, v, a, lam, self.system.held_data, out)

    def energy(self, t: float, q: Array, v: Array) -> float:
        """Kinetic and potential energy, J."""
        return float(energy(t, q, v, self.system.held_data))

    def bend(self, t: float, q: Array) -> Bend | None:
        """Return how plates bend at free positions q (nq,); None where there are none."""
        if not self.mechanism.plates:
            return None
        self.energy(t, q, np.zeros(self.system.n))  # places them
        return bend(self.mechanism, self.records(Plate), self.data.state)

    def residuals(self, t: float, q: Array, v: Array) -> tuple[float, float]:
        """Largest constraint residual in position and in velocity."""
        if self.system.m == 0:
            return 0.0, 0.0
        terms = self.system.allocate_terms()
        self.system.fill(t, q, v, terms)
        return tuple(float(largest_residual(which, *self.kernel_data)) for which in (False, True))  # type: ignore[return-value]

    def adopt(self, other: Plant) -> None:
        """Take over the numbers of a plant of the same structure, built with other parameter values.

        Inputs keep their values. Raises UserError where the structures differ.
        """
        mine: Any = self.data.arrays
        theirs: Any = other.data.arrays
        alike = all(a.shape == b.shape for a, b in zip(mine, theirs, strict=True))
        if not alike or np.any(mine.kept != theirs.kept) or np.any(mine.kernels != theirs.kernels):
            raise UserError("the parameter changes the structure of the mechanism; it cannot change during a run")
        inputs = self.inputs.state()
        for a, b in zip(mine, theirs, strict=True):
            a[...] = b
        self.inputs.restore(inputs)
