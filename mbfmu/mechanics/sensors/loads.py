"""What a force of a mechanism exerts: it is evaluated once more, on its own, and the state is left as it was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.dispatch import apply_load
from mbfmu.mechanics.kind import Attachment
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, i8

from .base import Follows, Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Reals


class LoadWrenchRecord(Record):
    """Parameters of :class:`LoadWrench`."""

    index: i8
    component: i8
    a: i8
    b: i8


class LoadEffortRecord(Record):
    """Parameters of :class:`LoadEffort`."""

    index: i8
    v: i8


@kernel
def _take_wrench(F: Reals) -> Any:
    """Six numbers of a wrench, which is zero then."""
    kept = (F[0], F[1], F[2], F[3], F[4], F[5])
    for k in range(6):
        F[k] = 0.0
    return kept


@kernel
def wrench(sensor: LoadWrenchRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. Component 0 to 5: on body a, 6 to 11: on body b."""
    Fa, Fb, k = state.bodies[sensor.a].F, state.bodies[sensor.b].F, sensor.component
    kept_a, kept_b, power = _take_wrench(Fa), _take_wrench(Fb), state.cached_power[0]
    apply_load(arrays.loads[sensor.index], state.time[0].real, arrays, state)
    found = Fa[k] if k < 6 else Fb[k - 6]
    for i in range(6):  # b first: what they were is that of a where both are one
        Fb[i] = kept_b[i]
    for i in range(6):
        Fa[i] = kept_a[i]
    state.cached_power[0] = power
    return found


@kernel
def effort(sensor: LoadEffortRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    v = sensor.v
    kept, power = state.Q[v], state.cached_power[0]
    state.Q[v] = 0.0
    apply_load(arrays.loads[sensor.index], state.time[0].real, arrays, state)
    found = state.Q[v]
    state.Q[v], state.cached_power[0] = kept, power
    return found


@dataclass(frozen=True, kw_only=True)
class OfLoad(Sensor):
    """What one force of the mechanism exerts."""

    follows = Follows.FORCES

    def loads(self) -> Sequence[int]:
        """Return the number of the force."""
        return (self.item.index,)


@dataclass(frozen=True, kw_only=True)
class LoadWrench(OfLoad):
    """Global component of the wrench that a force exerts about the origin of body a, from component 6 on of body b."""

    record = LoadWrenchRecord
    read = wrench

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the two bodies too."""
        super().fill(record, site)
        record["a"], record["b"] = site.bodies


@dataclass(frozen=True, kw_only=True)
class LoadEffort(OfLoad):
    """What a joint force exerts along the coordinate of its joint."""

    record = LoadEffortRecord
    read = effort

    def fill(self, record: Any, site: Attachment) -> None:
        """Write which force, and where its coordinate is in State.v."""
        record["index"], record["v"] = self.item.index, site.v + self.component
