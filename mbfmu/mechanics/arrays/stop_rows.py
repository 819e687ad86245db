"""Constraint equations that hold sensors at their stops during a part of a run.

Each sensor of a stop that a cut joint can hold has one: a position is held by a point in a plane, a distance by a rod.
These cut joints are no part of the mechanism. They are in data that share all arrays with those of the mechanism, but
for the tables of cut joints and of constraint equations, which are longer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.records import CutRecord, Data, RowRecord
from solvers.system import Array, System

if TYPE_CHECKING:
    from .compile import CompiledElements
    from .systems import Systems


class StopRows:
    """The constraint equations that hold sensors at stops.

    Parameters
    ----------
    mechanism, elements
        Mechanism and its elements.
    length
        Characteristic length, m.

    Attributes
    ----------
    names
        Names of the events of these stops; none in mechanisms whose friction follows reactions, which would follow the
        forces of the stops, too.
    """

    def __init__(self, mechanism: Mechanism, elements: CompiledElements, length: float) -> None:
        arrays, state = elements.data.arrays, elements.data.state
        held = [(event.name, event.holding_cut) for event in mechanism.events]
        cuts = [(name, cut) for name, cut in held if cut is not None and not len(state.bearings)]
        self.names = [name for name, _ in cuts]
        self._arrays, first, count = arrays, len(arrays.kept), len(cuts)
        self._sizes = np.full(count, length)
        own = CutRecord.zeros(count)
        own["kind"], own["at"] = elements.holding[:count].T
        own["a"], own["b"] = np.array([(cut.a, cut.b) for _, cut in cuts], np.int64).reshape(-1, 2).T
        own["row"] = first + np.arange(count)
        own["end"] = own["row"] + 1
        rows = RowRecord.zeros(first + count)
        longer = arrays._replace(
            cuts=CutRecord.zeros(len(arrays.cuts) + count),
            kept=np.full(first + count, -1),
            residual_scale=np.concatenate((arrays.residual_scale, np.ones(count))),
        )
        longer.cuts[: len(arrays.cuts)], longer.cuts[len(arrays.cuts) :] = arrays.cuts, own
        self._data = Data(longer, state._replace(rows=rows))

    def system(self, systems: Systems, names: Sequence[str], held: Sequence[int]) -> System:
        """Return the system with the equations that are kept today, by their names, and those that hold stops.

        ``held`` are numbers of stops in ``names``, ascending.
        """
        kept, first = self._data.arrays.kept, len(self._arrays.kept)
        kept[:first], kept[first:] = self._arrays.kept, -1
        kept[first + np.array(held, np.int64)] = len(names) + np.arange(len(held))
        own = [f"stop {self.names[k]!r}" for k in held]
        return systems.with_stop_rows(self._data, self._sizes).dense([*names, *own], self._data)

    def slopes(self, systems: Systems, names: Sequence[str], t: float, q: Array, v: Array) -> tuple[Array, Array]:
        """Return J (k, n) and gamma (k,) of all stops at a state: the accelerations of the sensors are J a - gamma.

        No stop holds at this time.
        """
        system = self.system(systems, names, range(len(self.names)))
        terms = system.allocate_terms()
        system.fill(t, q, v, terms)
        m = len(names)
        return terms.J[m:].copy(), terms.gamma[m:].copy()
