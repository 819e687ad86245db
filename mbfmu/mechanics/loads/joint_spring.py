"""Spring-damper in a joint of one coordinate: -(k (q - q0) + c q') along it, rotational or translational."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics import law
from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.kind import Attachment
from solvers.compiled.kernel import jit_uncached, kernel
from solvers.compiled.record import i8

from .base import Force
from .elastic import ElasticForce, ElasticRecord, elastic_energy, elastic_force
from .joint_force import kernels_of_law as kernels_of_given_law

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


class JointSpringRecord(ElasticRecord):
    """Parameters of :class:`JointSpring`."""

    q: i8
    v: i8


@kernel
def apply(force: JointSpringRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    f = elastic_force(force, state.q[force.q] - force.free, arrays)
    state.Q[force.v] -= f + force.damping * state.v[force.v]


@kernel
def potential(force: JointSpringRecord, arrays: Arrays, state: State) -> float:
    """Energy of the stretch."""
    return elastic_energy(force, state.q[force.q] - force.free, arrays)


@kernel
def power(force: JointSpringRecord, t: float, arrays: Arrays, state: State) -> float:
    """-c q'^2."""
    return -force.damping * state.v[force.v] * state.v[force.v]


class MovingJointSpringRecord(JointSpringRecord):
    """Parameters of :class:`JointSpring` whose unloaded coordinate is a signal."""

    signal: i8


@kernel
def moving_force(force: MovingJointSpringRecord, t: float, arrays: Arrays, state: State) -> float:
    """Force against the coordinate."""
    f = elastic_force(force, state.q[force.q] - signal_value(force.signal, t, arrays), arrays)
    return f + force.damping * state.v[force.v]


@kernel
def apply_moving(force: MovingJointSpringRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    state.Q[force.v] -= moving_force(force, t, arrays, state)


@kernel
def power_moving(force: MovingJointSpringRecord, t: float, arrays: Arrays, state: State) -> float:
    """Force times rate of the coordinate."""
    return -moving_force(force, t, arrays, state) * state.v[force.v]


class MovingJointSpring(Force):
    """Record and kernels of a :class:`JointSpring` whose unloaded coordinate is a signal."""

    record = MovingJointSpringRecord
    apply = apply_moving
    power = power_moving


@cache
def kernels_of(f: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a spring whose force is a function."""
    at = law.at

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        rate = state.v[force.v]
        state.Q[force.v] -= at(f, t, state.q[force.q] - force.free, rate) + force.damping * rate

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        rate = state.v[force.v]
        return -(at(f, t, state.q[force.q] - force.free, rate) + force.damping * rate) * rate

    return jit_uncached(apply), jit_uncached(power)


@cache
def kernels_of_quantities(value: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a spring or a damper whose law the kernel ``value`` evaluates."""

    def push(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        rate = state.v[force.v]
        return -value(force, t, arrays, state, state.q[force.q] - force.free, rate) - force.damping * rate

    return kernels_of_given_law(jit_uncached(push))


@dataclass(frozen=True, kw_only=True)
class JointSpring(ElasticForce):
    """Spring-damper on the joint coordinate of a body.

    Parameters
    ----------
    stiffness, damping
        Stiffness and damping: N m/rad and N m s/rad for an angle, N/m and N s/m for a displacement; a ``Table`` in
        place of a stiffness gives the force over the deflection x, as does a function ``lambda x: ...`` or an
        expression ``"3 * x**3"``: the work of such a function is computed, its energy is not. With ``uses`` also of
        the time t (s), the rate v of the coordinate and the names there.
    free
        Unloaded coordinate, rad or m: a number, or a signal or an input, as of a servo drive with a given stiffness.
        The work of a spring with a signal is computed, its energy is not.
    uses
        Other quantities in a function or expression, by their names, see :class:`.JointForce`.
    """

    record = JointSpringRecord
    on_joint = True
    drawn = "coil"
    apply = apply
    potential = potential
    power = power
    kernels_of_law = kernels_of
    kernels_of_quantities = kernels_of_quantities
    moving = MovingJointSpring
    variants = (MovingJointSpring,)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write where it acts too."""
        super().fill(record, site)
        record["q"], record["v"] = site.q, site.v
