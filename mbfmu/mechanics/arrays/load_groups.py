"""All loads of one type, with the bodies where they are: what a type is asked about itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.loading import Acting
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.dispatch import load_misplacement, load_monitor
from mbfmu.mechanics.kind import kernel_of, record_of
from mbfmu.mechanics.loads import Load
from mbfmu.mechanics.loads.base import MAX_MISPLACEMENT
from mbfmu.mechanics.records import Data
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel, records
from solvers.diagnostics import Diagnostic

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, ItemRecord, State
    from solvers.compiled.record import Table


MISPLACED_LOAD = Diagnostic.error(
    "invalid-value",
    "{name!r} is misplaced at the start: its bodies are {gap:.3g} times as far from the places that it requires as is "
    "allowed",
    "Give start positions in which they are nearer to these",
)


@dataclass(frozen=True, kw_only=True)
class LoadGroup:
    """All loads of one type in a mechanism.

    Attributes
    ----------
    mechanism
        Mechanism.
    acting
        The loads, their names and bodies, in the order of addition.
    numbers
        Their numbers among all loads.
    data
        Arrays and state of the mechanism, with the bodies where they are.
    kernel_data
        The same as kernels take them.
    """

    mechanism: Mechanism
    acting: Sequence[Acting]
    numbers: NDArray[np.int64]
    data: Data
    kernel_data: Any

    @property
    def records(self) -> NDArray[Any]:
        """Copies of their records, in this order."""
        dtype, memory = record_of(self.acting[0].load), self.data.arrays.memory
        found = records(len(self.acting), dtype)
        for k, place in enumerate(self.data.arrays.loads["at"][self.numbers]):
            found[k] = memory[place : place + dtype.itemsize].view(dtype)[0]
        return found

    @property
    def bodies(self) -> NDArray[Any]:
        """Where the bodies are, by their numbers; fields of ``mbfmu.mechanics.records.MotionRecord``."""
        return self.data.state.bodies

    @property
    def gravity(self) -> float:
        """Magnitude of gravity, m/s^2."""
        return float(np.linalg.norm(self.data.arrays.world[0]["gravity"]))

    def require_places(self) -> None:
        """Raise UserError if bodies of a load are farther from the places that it requires than is allowed."""
        loads: Any = self.data.arrays.loads
        k, ratio = find_misplaced_load(loads[self.numbers], *self.kernel_data)
        if not ratio <= MAX_MISPLACEMENT:
            raise UserError(str(MISPLACED_LOAD).format(name=self.acting[k].place, gap=ratio))

    def ask(self, hook: str, *arguments: Any) -> Any:
        """Return what a class method of this type returns for these loads.

        Parameters
        ----------
        hook
            Name of the method, such as ``"check_start"``.
        arguments
            Further arguments.

        Returns
        -------
        Any
            Its result.

        Raises
        ------
        UserError
            From the method, or because it fails.
        """
        kind = type(self.acting[0].load)
        try:
            return getattr(kind, hook)(self, *arguments)
        except UserError:
            raise
        except Exception as error:
            raise UserError(f"{hook} of {kind.__name__} failed: {type(error).__name__}: {error}") from error

    def mesh_of(self, body: Any) -> Any:
        """Return the mesh that a body is a node of.

        Parameters
        ----------
        body
            Body of the mechanism.

        Returns
        -------
        Mesh or None
            Mesh; None: the body is a node of none.
        """
        own = (mesh for mesh in self.mechanism.meshes if any(body is node for row in mesh.nodes for node in row))
        return next(own, None)


def load_groups(mechanism: Mechanism, data: Data, kernel_data: Any, hook: str) -> Iterator[LoadGroup]:
    """Yield the loads of every type that defines this method or has this kernel."""
    by_type: dict[type[Load], list[tuple[int, Acting]]] = {}
    for number, acting in enumerate(mechanism.loads()):
        if kernel_of(acting.load, hook) not in (None, kernel_of(Load, hook)):
            by_type.setdefault(type(acting.load), []).append((number, acting))
    for found in by_type.values():
        numbers, loads = zip(*found, strict=True)
        own = np.array(numbers, np.int64)
        yield LoadGroup(mechanism=mechanism, acting=loads, numbers=own, data=data, kernel_data=kernel_data)


@kernel
def largest_ratio(loads: Table[ItemRecord], arrays: Arrays, state: State) -> float:
    """The largest value of ``monitor`` of these loads (k,), ItemRecord, where the bodies are."""
    largest = 0.0
    for k in range(loads.shape[0]):
        ratio = load_monitor(loads[k], arrays, state)
        if not ratio <= largest:  # nan as well
            largest = ratio
    return largest


@kernel
def find_misplaced_load(loads: Table[ItemRecord], arrays: Arrays, state: State) -> tuple[int, float]:
    """Return the load whose ``misplacement`` is the largest of these loads (k,), ItemRecord, and this number; bodies
    are where they are.
    """
    worst, largest = 0, 0.0
    for k in range(loads.shape[0]):
        ratio = load_misplacement(loads[k], arrays, state)
        if not ratio <= largest:
            worst, largest = k, ratio
    return worst, largest
