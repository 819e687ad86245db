"""A compiled mechanism as solvers take it: by its matrices, or as a large tree by its recursions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Set
from copy import copy
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.elimination import MAX_DENSE_LOOP_COORDINATES, eliminate_constraints
from mbfmu.mechanics.records import Data
from mbfmu.mechanics.recursions import dynamics as recursions
from mbfmu.mechanics.recursions.dynamics import input_step_limit, observe_all
from mbfmu.mechanics.tangent import Groups, MissingTangent, Tangent, coupled_states, find_groups
from mbfmu.util.errors import UserError
from solvers.compiled.tuple_pointer import pin, unpin
from solvers.positions import Positions, place_states
from solvers.system import (
    AnySystem,
    Array,
    ComplexStepSystem,
    EliminationEquations,
    System,
    TreeSystem,
    no_rows,
)

from .assembly import free_bodies
from .compile import CompiledElements
from .extrapolation import ExtrapolatedStress
from .inputs import Drives
from .numbering import Numbering, held_states
from .scale import coordinate_sizes, row_sizes, spans
from .state_use import find_state_use

MAX_DENSE_TREE_COORDINATES = 60  # coordinates of a tree without loops, or of any with nonholonomic constraints, from
# which on no dense matrix is made
MAX_COUPLED_STATES = 200  # first-order states that the structured tangent does not condense: it has a matrix of these
MAX_GROUP_BODIES = 1000  # bodies in a group of the structured tangent: its matrix has twelve rows a body


class Elimination(NamedTuple):
    """A mechanism whose constraints are eliminated, as solvers take it."""

    equations: Callable[[], EliminationEquations]
    tangent: Callable[[], Tangent]

    def __call__(self) -> EliminationEquations:
        """Return the equations with eliminated constraints, pinned."""
        return self.equations()


class Systems:
    """Makes the equations of motion of one compiled mechanism over its free coordinates.

    Attributes
    ----------
    row_size
        Units of the residuals of all constraint equations, including trivially satisfied ones.
    """

    def __init__(
        self, mechanism: Mechanism, numbering: Numbering, elements: CompiledElements, drives: Drives, length: float
    ) -> None:
        self._mechanism, self._numbering, self._elements = mechanism, numbering, elements
        self._drives, self._length, self._data, self._arrays = drives, length, elements.data, elements.data.arrays
        self._locked: Set[int] = frozenset()
        self._holds_stops = False
        self._model_size = 0, 0  # coordinates and constraint equations without locked joints, if there are some
        nominal = [state.nominal for _, state in numbering.states]
        self._size = np.concatenate((coordinate_sizes(free_bodies(mechanism), length), nominal))
        self.row_size = np.concatenate([np.zeros(0), *(row_sizes(c, length) for c in mechanism.constraints)])
        limit = MAX_DENSE_LOOP_COORDINATES if mechanism.constraints else MAX_DENSE_TREE_COORDINATES
        self._nonholonomic = np.array([own for c in mechanism.constraints for own in c.nonholonomic], bool)
        # flexible bodies require matrices, and steady states of models with first-order states, except with meshes
        self._needs_matrices = bool(mechanism.flexible_bodies or (numbering.states and not mechanism.meshes))
        few = len(coupled_states(list(mechanism.loads()))) <= MAX_COUPLED_STATES
        self._can_factor = few and not mechanism.flexible_bodies
        self._large = not self._needs_matrices and numbering.nv > limit
        if self._nonholonomic.any() and numbering.nv > MAX_DENSE_TREE_COORDINATES:
            wheel = next(handle.name for handle in mechanism.cuts if handle.cut.nonholonomic)
            raise UserError(
                f"the mechanism has wheel {wheel!r}, which rolls without slip, and {numbering.nv} coordinates and "
                f"states; allowed with nonholonomic constraints: at most {MAX_DENSE_TREE_COORDINATES}. Use fewer bodies"
            )
        if numbering.bearings and mechanism.flexible_bodies:
            raise UserError(
                "the mechanism has joint friction with a Reaction as the normal force and flexible bodies; allowed: "
                "rigid bodies. Give normal_force as a number, a signal or a law"
            )
        if self._large and numbering.bearings:
            raise UserError(
                "the mechanism has joint friction with a Reaction as the normal force and a mesh of elements; allowed: "
                f"meshes with at most {limit} coordinates and states. Give normal_force as a number, a signal or a law"
            )
        if self._large and not few:
            raise UserError(
                f"the mechanism has a mesh of elements and more than {MAX_COUPLED_STATES} first-order states of other "
                f"elements than joint friction; allowed: at most {MAX_COUPLED_STATES}. Use fewer states"
            )

    def with_locked_joints(
        self, locked: Set[int], positions: int, remaining: NDArray[np.bool_], constraints: int
    ) -> Systems:
        """Return the systems whose arrays are numbered with the joints of these bodies locked, see :mod:`.joint_locks`.

        ``positions`` is the number of free positions; ``remaining`` (n,) states which velocities and first-order states
        remain free. ``constraints`` is the number of constraint equations without locked joints.
        """
        found = copy(self)
        found._model_size = len(remaining), constraints
        found._locked, found._size, found._numbering = locked, self._size[remaining], copy(self._numbering)
        numbering = found._numbering
        numbering.nq, numbering.nv = positions, int(remaining.sum())
        names = zip(self._numbering.coordinate_names, remaining, strict=True)
        numbering.coordinate_names = [name for name, remains in names if remains]
        return found

    def with_stop_rows(self, data: Data, sizes: Array) -> Systems:
        """Return the systems of data with further constraint equations, whose residuals have these sizes (k,), see
        :mod:`.stop_rows`.
        """
        found = copy(self)
        found._holds_stops, found._data, found._arrays = True, data, data.arrays
        found.row_size = np.append(self.row_size, sizes)
        found._nonholonomic = np.append(self._nonholonomic, np.zeros(len(sizes), bool))
        return found

    def make(self, constraint_names: list[str]) -> AnySystem:
        """Return the system with the rows that are kept today, by their names."""
        if self._numbering.nv and (self._large or self._has_left_loops(constraint_names)):
            return self._tree(constraint_names)
        return self.dense(constraint_names, self._elements.data)

    def _has_left_loops(self, constraint_names: list[str]) -> bool:
        """Whether locked joints leave a large model without loops, which is a large tree for all solvers."""
        return not self._needs_matrices and not constraint_names and self._model_size[0] > MAX_DENSE_TREE_COORDINATES

    def make_complex(self, constraint_names: list[str]) -> System:
        """Return the system as it is now on complex numbers, for derivatives by complex step."""
        return self.dense(constraint_names, self._elements.complex_data(), complex)

    def dense(self, constraint_names: list[str], data: Data, scalar: type = float) -> System:
        """Return the system by its matrices."""
        is_real = scalar is float
        return System(
            **self._common(constraint_names, data),
            dynamics=recursions.dynamics,
            motion=recursions.motion,
            energy=recursions.energy,
            loop_rate=self._loop_rate(),
            power=recursions.power if is_real else None,
            evaluate_energy_bound=recursions.evaluate_energy_bound if is_real else None,
            evaluate_outputs=recursions.evaluate_outputs if is_real else None,
            recursions=self._recursions if self._has_recursions(constraint_names) else None,
            has_tangent=self._has_tangent,
        )

    @property
    def _has_tangent(self) -> bool:
        """Whether there is a structured tangent: drives and locked joints may leave first-order states alone."""
        return self._can_factor and self._numbering.nv > len(self._numbering.states) and not self._holds_stops

    def _has_recursions(self, constraint_names: list[str]) -> bool:
        """Whether a mechanism that is solved by matrices can be solved by recursions, too."""
        if self._numbering.bearings:  # friction that follows reactions is determined with the mass matrix
            return False
        return self._needs_matrices and not constraint_names and not self._mechanism.meshes

    def _recursions(self) -> TreeSystem:
        """Return the recursions of a tree that is solved by matrices, too; see :attr:`System.recursions`."""
        return TreeSystem(
            **self._common([], self._elements.data),
            **_tree_equations(),
            make_tangent=self.tangent if self._has_tangent else MissingTangent,
            make_missing_tangent=MissingTangent,
            complex_step=self._complex_step,
            mesh_mask=np.zeros(self._numbering.nv, bool),
        )

    def _tree(self, constraint_names: list[str]) -> TreeSystem:
        """Return the system of a large tree."""
        data = self._elements.data
        return TreeSystem(
            **self._common(constraint_names, data),
            **_tree_equations(),
            make_tangent=self.tangent if self._has_tangent else MissingTangent,
            make_missing_tangent=MissingTangent,
            dense=lambda: self.dense(constraint_names, data),
            complex_step=self._complex_step,
            mesh_mask=self._find_mesh_mask(),
            mesh_motion=recursions.mesh_motion,
            mesh_length=self._mesh_length(),
            friction_velocity=self._slip(),
            moves=self._moves,
            stress_extrapolation=ExtrapolatedStress(self._mechanism, self._elements, unpin(self._held)) or None,
        )

    def _positions(self) -> Positions:
        """Return where free positions and velocities are, by the joints."""
        places: list[tuple[int, int]] = []
        quaternions: list[tuple[int, int]] = []
        for record in self._arrays.bodies:
            if record["vf"] < 0:
                continue
            plain = int(record["nq"] - 4 * record["quaternion"])
            places += [(int(record["qf"]) + k, int(record["vf"]) + k) for k in range(plain)]
            if record["quaternion"]:
                quaternions.append((int(record["qf"]) + plain, int(record["vf"]) + plain))
        in_q, in_v = np.ascontiguousarray(np.array(places, np.int64).reshape(-1, 2).T)
        states = place_states(self._numbering.nv, len(self._numbering.states))
        return Positions(in_q, in_v, np.array(quaternions, np.int64).reshape(-1, 2), states)

    def _complex_step(self) -> ComplexStepSystem:
        """Return the recursions on complex numbers with the arrays, which may change later."""
        equations = recursions.inverse, recursions.position, recursions.retract
        return ComplexStepSystem(*equations, self._elements.complex_step_data())

    def _find_mesh_mask(self) -> NDArray[np.bool_]:
        """Return which coordinates are of joints between nodes of a mesh."""
        found = [np.full(body.joint.nv, self._in_mesh(body)) for body in self._free_bodies()]
        return np.concatenate([np.zeros(0, bool), *found, np.zeros(len(self._numbering.states), bool)])

    def _free_bodies(self) -> list[Body]:
        return [body for body in free_bodies(self._mechanism) if body.index not in self._locked]

    def _mesh_length(self) -> float:
        """Return the length of the longest path over nodes of a mesh, each joined to the one before, m; 0 without."""
        paths = dict.fromkeys(self._nodes, 0.0)
        for i in sorted(self._nodes):
            body = self._arrays.bodies[i]
            paths[i] = paths.get(int(body["parent"]), 0.0) + float(np.linalg.norm(body["s"]))
        return max(paths.values(), default=0.0)

    def _in_mesh(self, body: Body) -> bool:
        return {body.index, body.parent} <= self._nodes

    @cached_property
    def _nodes(self) -> set[int]:
        """The bodies that are nodes of meshes."""
        return {body.index for mesh in self._mechanism.meshes for row in mesh.nodes for body in row}

    def _slip(self) -> Array:
        """Return rates (n,) that move meshes as a whole, or bodies that rub on them, by the slip at which friction
        turns over.

        A node that carries a mesh by six coordinates rotates with its vibrations, which do not describe the whole.
        """
        slowest = min((acting.load.slip_scale for acting in self._mechanism.others), default=np.inf)
        carrying = find_ancestors(self._mechanism, self._nodes)
        found = [np.zeros(0)]
        for body in self._free_bodies():
            units = body.joint.units
            turning = slowest / self._length if body.index in carrying and "m" not in units else np.inf
            rates = [slowest if unit == "m" else turning for unit in units]
            found.append(np.full(body.joint.nv, np.inf) if self._in_mesh(body) else np.array(rates))
        return np.concatenate([*found, np.full(len(self._numbering.states), np.inf)])

    def _common(self, constraint_names: list[str], data: Data) -> dict[str, Any]:
        """Return what both have."""
        kept = self._arrays.kept
        return {
            "nq": self._numbering.nq,
            "n": self._numbering.nv,
            "n_states": len(self._numbering.states),
            "m": len(constraint_names),
            "data": data,
            "position": recursions.position,
            "retract": recursions.retract,
            "size": self._size,
            "row_size": self.row_size[kept >= 0] if constraint_names else np.zeros(0),
            "nonholonomic": np.flatnonzero(self._nonholonomic[kept >= 0]) if constraint_names else no_rows(),
            "positions": self._positions(),
            "rate": self._rate(),
            "nonsmooth_reason": self._first_reason("nonsmooth_reason"),
            "stiffness_reason": self._first_reason("stiffness_reason"),
            "stick_reason": self._first_reason("stick_reason"),
            "held_states": tuple(held_states(self._mechanism)),
            "observe": observe_all,
            "works": self._works,
            "elimination": self._elimination(),
            "input_step_limit": self._resolves,
            "longest_load_step": recursions.longest_load_step,
            "coordinate_names": tuple(self._numbering.coordinate_names),
            "constraint_names": tuple(constraint_names),
            "model_size": self._model_size,
        }

    def _elimination(self) -> Elimination | Callable[[], EliminationEquations] | None:
        """Return what eliminates constraints along the tree; None if there are none, or if matrices are required.

        With flexible bodies there is no structured tangent, which implicit solvers require, nor with equations that
        hold stops.
        """
        numbering = self._numbering
        needs_matrices = self._nonholonomic.any() or numbering.bearings or numbering.nv == len(numbering.states)
        if needs_matrices or not (self._mechanism.constraints or self._holds_stops):
            return None
        return Elimination(self._eliminate, self.tangent) if self._has_tangent else self._eliminate

    def _eliminate(self) -> EliminationEquations:
        """Return the equations with the constraints that are kept today eliminated."""
        lengths = spans(self._mechanism, self._arrays)
        typical = float(np.median(lengths[lengths > 0.0])) if np.any(lengths > 0.0) else self._length
        row_size = self.row_size[self._arrays.kept >= 0]
        return eliminate_constraints(self._arrays, self._data.state, self._size.copy(), row_size, typical)

    def _first_reason(self, which: str) -> str:
        """Return the first reason of this name that a load gives; empty: none does."""
        return next(filter(None, (getattr(acting.load, which) for acting in self._mechanism.loads())), "")

    def tangent(self, groups: Groups | None = None) -> Tangent:
        """Return the structured tangent over these groups of bodies, or those that joints and loads tie."""
        found = self._groups() if groups is None else groups
        loads, states = list(self._mechanism.loads()), len(self._numbering.states)
        first = self._numbering.nv_full - states
        use = find_state_use(self._mechanism, self._elements, first) if states else []
        return Tangent(self._elements.tangent_arrays(), self._elements.data.state, found, loads, use)

    def _groups(self) -> Groups:
        """Return the groups of the structured tangent; UserError where they would be too wide to be solved."""
        groups = find_groups(self._mechanism, self._locked)
        widest = int(np.bincount(groups.of[1:]).argmax())
        members = np.flatnonzero(groups.of == widest)
        if len(members) > MAX_GROUP_BODIES:
            raise UserError(
                f"joints, forces and elements connect {len(members)} bodies, "
                f"{self._mechanism.bodies[members[-1]].name!r} among them, so that they must be solved at once; "
                f"allowed: {MAX_GROUP_BODIES}; connect bodies that are near each other in the tree, or use 'adams' if "
                "the model is not stiff"
            )
        return groups

    def _moves(self) -> bool:
        return any(self._drives.rates())

    def _works(self) -> bool:
        return bool(self._arrays.world[0]["nonconservative"])

    def _resolves(self, t: float) -> tuple[float, float]:
        """Return the longest step from t on that misses no signal, and until when it does not, s."""
        return input_step_limit(t, self._held)

    @cached_property
    def _held(self) -> Any:
        """The data as kernels take them."""
        return pin(self._elements.data)

    def _rate(self, bodies: Iterable[int] | None = None) -> float:
        """Return how fast gravity and drives, or the drives of these bodies, move them, 1/s; zero: neither does."""
        weight = float(np.linalg.norm(self._arrays.world["gravity"][0]))
        return max(
            np.sqrt(weight / self._length), *(1.0 / time_scale for time_scale in self._drives.time_scales(bodies)), 0.0
        )

    def _loop_rate(self) -> float:
        """Return how fast gravity and the drives that carry a cut joint's bodies or are coupled move them, 1/s."""
        ends = {end.index for cut in self._mechanism.cuts for end in (cut.a, cut.b)}
        carrying = find_ancestors(self._mechanism, ends)
        carrying.update(end.index for coupling in self._mechanism.couplings for end in (coupling.a, coupling.b))
        return self._rate(carrying)


def _tree_equations() -> dict[str, Any]:
    """Return the recursions along a tree by their names in a system."""
    names = "inverse", "forward", "mobility", "constraints", "inertia_parts", "evaluate_energy_bound"
    return {"power": recursions.solved_power, **{name: getattr(recursions, name) for name in names}}


def find_ancestors(mechanism: Mechanism, bodies: Iterable[int]) -> set[int]:
    """Return these bodies and all that carry them, by number."""
    found: set[int] = set()
    for body in bodies:
        k = body
        while k > 0 and k not in found:
            found.add(k)
            k = mechanism.bodies[k].parent
    return found
