"""Identities of a mechanism at a state, and what contradicts them.

Each compares two ways to the same numbers: a kernel with the derivative of another, or one recursion with another one.
Derivatives are central differences of sixth order along the path with constant accelerations through the state. The
difference of the results of two step sizes is their uncertainty.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from solvers.compiled.kernel import kernel
from solvers.system import Array, Terms

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Data
    from solvers.compiled.record import Reals

STENCIL = {-3: -1 / 60, -2: 9 / 60, -1: -45 / 60, 1: 45 / 60, 2: -9 / 60, 3: 1 / 60}
STEP = 1e-3  # of the central differences: s, or the units of the coordinates
PATH_STEPS = 4  # Runge-Kutta steps to each point of the path
COMPLEX_STEP = 1e-30
TOLERANCE = 1e-8  # relative to the largest number that enters
MAX_UNCERTAINTY = 1e-5  # of a derivative, relative; above it the mechanism is not smooth at the state


class State(NamedTuple):
    """Time, positions, velocities and accelerations of the free coordinates; multipliers of the constraints."""

    t: float
    q: Array
    v: Array
    a: Array
    lam: Array


class Deviation(NamedTuple):
    """Largest difference of two numbers that must be equal, relative to the largest that enters.

    ``found`` and ``expected`` are the two numbers where it is largest, ``where`` names them. ``uncertainty`` is that of
    the expected one, relative; it is zero unless it is a derivative by differences.
    """

    size: float
    found: float
    expected: float
    where: str
    uncertainty: float = 0.0


@kernel
def _power(function: Any, t: float, q: Reals, v: Reals, a: Reals, lam: Reals, data: Data) -> float:
    power: float = function(t, q, v, a, lam, data)
    return power


def random_state(compiled: CompiledMechanism, rng: np.random.Generator, length: float) -> State:
    """Return a random state; coordinates that are lengths deviate by about ``length`` (m) from the start.

    First-order states are of the size of their nominal values, and change as their equations say.
    """
    system = compiled.system
    free = [body.joint for body in compiled.mechanism.bodies[1:] if body.joint.drive is None]
    size, moving = system.size.copy(), system.n_velocities
    size[:moving] = [length if unit == "m" else 1.0 for joint in free for unit in joint.units]
    q = compiled.assembly.start_positions()
    system.apply(q, size * rng.normal(size=system.n))
    v, a = (size * rng.normal(size=system.n) for _ in range(2))
    t, lam = float(rng.normal()), rng.normal(size=system.m)
    if system.n_states:
        terms = system.allocate_terms()
        system.fill(t, q, v, terms)
        a[moving:] = -terms.h[moving:]
    return State(t, q, v, a, lam)


def path(compiled: CompiledMechanism, at: State, shift: float) -> tuple[float, Array, Array]:
    """Return time, positions and velocities a time ``shift`` (s) after a state.

    They are integrated by Runge-Kutta's method from q' = N v and v' = a.
    """
    system, terms, q, h = compiled.system, compiled.system.allocate_terms(), at.q.copy(), shift / PATH_STEPS

    def rate(place: Array, x: float) -> Array:
        system.fill(at.t + x, place, at.v + x * at.a, terms)
        qdot: Array = terms.qdot.copy()
        return qdot

    for i in range(PATH_STEPS):
        x = i * h
        k1 = rate(q, x)
        k2 = rate(q + h / 2 * k1, x + h / 2)
        k3 = rate(q + h / 2 * k2, x + h / 2)
        k4 = rate(q + h * k3, x + h)
        q = q + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return at.t + shift, q, at.v + shift * at.a


def difference_quotient(function: Callable[[float], Any], step: float = STEP) -> Any:
    """Return the derivative of a function at zero by central differences of sixth order."""
    return sum(weight * np.asarray(function(k * step), dtype=float) for k, weight in STENCIL.items()) / step


def differences(function: Callable[[float], Any]) -> tuple[Array, Array]:
    """Return the derivative of a function at zero by differences, and how far it can be trusted."""
    found, coarse = (difference_quotient(function, step) for step in (0.5 * STEP, STEP))
    doubt: Array = np.abs(found - coarse)
    return found, doubt


def compare(
    found: Any, expected: Any, names: list[str], uncertainty: Any = 0.0, scale: float = 0.0, least: float = 1.0
) -> Deviation:
    """Return where two arrays differ most; ``scale`` is the largest number in the sums that they are, ``least`` what
    the numbers are at least compared with.
    """
    found, expected = np.ravel(found), np.ravel(expected)
    unsure = np.broadcast_to(np.ravel(uncertainty), found.shape)
    if not found.size:
        return Deviation(0.0, 0.0, 0.0, "")
    size = max(least, scale, float(np.abs(found).max()), float(np.abs(expected).max()))
    difference = np.abs(found - expected)
    k = int(np.argmax(np.where(np.isfinite(difference), difference, np.inf)))
    return Deviation(
        float(difference[k]) / size, float(found[k]), float(expected[k]), names[k], float(unsure.max()) / size
    )


def energy_rate(compiled: CompiledMechanism, at: State) -> Iterator[Deviation]:
    """The energy changes by the power of what has no potential, and by what moves the coordinates: `power`."""
    system, terms = compiled.system, compiled.system.allocate_terms()
    rate, unsure = differences(lambda shift: compiled.energy(*path(compiled, at, shift)))
    system.fill(at.t, at.q, at.v, terms)
    power = _power(system.power, at.t, at.q, at.v, at.a, at.lam, system.pinned_data)
    effort = terms.M @ at.a + terms.h + terms.J.T @ at.lam
    total = power + effort @ at.v - at.lam @ (terms.J @ at.v - terms.nu)
    scale = max(abs(power), abs(compiled.energy(at.t, at.q, at.v)), float(np.abs(effort).max(initial=0.0)))
    yield compare(total, rate, ["power of all forces against the rate of the energy, W"], unsure, scale)


def constraint_rates(compiled: CompiledMechanism, at: State) -> Iterator[Deviation]:
    """The Jacobian, nu and gamma of constraints are the derivatives of their residuals, gamma of nonholonomic ones that
    of their velocities.
    """
    system, terms = compiled.system, compiled.system.allocate_terms()

    def residuals(shift: float) -> Array:
        t, q, v = path(compiled, at, shift)
        system.fill(t, q, v, terms)
        return np.concatenate((terms.Phi, terms.J @ v - terms.nu))

    rates, unsure = differences(residuals)
    system.fill(at.t, at.q, at.v, terms)
    names = [
        f"{what} of constraint {name}" for what in ("rate", "second derivative") for name in system.constraint_names
    ]
    first = terms.J @ at.v - terms.nu
    first[system.nonholonomic] = 0.0
    yield compare(np.concatenate((first, terms.J @ at.a - terms.gamma)), rates, names, unsure)


def motions(compiled: CompiledMechanism, at: State) -> Iterator[Deviation]:
    """Velocities and accelerations of every body are the derivatives of its position."""
    outputs = [variable.name for variable in compiled.outputs]

    def observed(shift: float) -> Array:
        t, q, v = path(compiled, at, shift)
        out = np.zeros(len(outputs))
        compiled.observe(t, q, v, at.a, at.lam, out)
        return out

    rates, unsure = differences(observed)
    exact = observed(0.0)
    of = {name: k for k, name in enumerate(outputs)}
    pairs = [
        (f"{b.name}.{x}{i}", f"{b.name}.{y}{i}")
        for b in compiled.mechanism.bodies[1:]
        for x, y in ("rv", "va")
        for i in "xyz"
    ]
    first, second = ([of[f"_probe.{pair[k]}"] for pair in pairs] for k in (0, 1))
    names = [
        f"{'velocity' if '.v' in y else 'acceleration'} {y[-1]} of a point of body {y.split('.')[0]!r}"
        for _, y in pairs
    ]
    yield compare(exact[second], rates[first], names, unsure[first])


def mass_matrix(compiled: CompiledMechanism, at: State) -> Iterator[Deviation]:
    """The kinetic energy is half of v M v, and forward dynamics undoes inverse dynamics."""
    terms = compiled.system.allocate_terms()
    compiled.system.fill(at.t, at.q, at.v, terms)
    still, moving = at.v.copy(), compiled.system.n_velocities
    still[:moving] = 0.0  # first-order states have no kinetic energy
    rest = compiled.energy(at.t, at.q, still)
    kinetic = compiled.energy(at.t, at.q, at.v) - rest
    if not any(body.joint.drive is not None for body in compiled.mechanism.bodies):
        v, M = at.v[:moving], terms.M[:moving, :moving]
        yield compare(0.5 * v @ M @ v, kinetic, ["kinetic energy, J"], 0.0, abs(rest))
    yield compare(terms.M, terms.M.T, [f"M, entry {k}" for k in range(terms.M.size)])


def complex_derivatives(compiled: CompiledMechanism, at: State) -> Iterator[Deviation]:
    """Kernels are analytic: a step along i e gives the derivatives by differences, and real parts are unchanged."""
    rng, system = np.random.default_rng(0), compiled.complex_system()
    dq, dv = rng.normal(size=system.n), rng.normal(size=system.n)
    real = compiled.system.allocate_terms()

    def moved(shift: float) -> Array:
        q = at.q.copy()
        compiled.system.apply(q, shift * dq)
        compiled.system.fill(at.t, q, at.v + shift * dv, real)
        return np.concatenate([np.ravel(term) for term in real])

    terms = Terms.allocate(system.nq, system.n, system.m, complex)
    q: Any = at.q.astype(complex)
    step: Any = 1j * COMPLEX_STEP * dq
    system.apply(q, step)
    velocities: Any = at.v + 1j * COMPLEX_STEP * dv
    system.fill(at.t, q, velocities, terms)
    slopes, unsure = differences(moved)
    values, end = moved(0.0), 0
    for name, term in zip(Terms._fields, terms, strict=True):
        own, end = slice(end, end + term.size), end + term.size
        places = [f"{name}, entry {i}" for i in range(term.size)]
        yield compare(term.real, values[own], [f"real part of {place}" for place in places])
        where, scale = [f"derivative of {place}" for place in places], float(np.abs(values[own]).max(initial=0.0))
        yield compare(term.imag / COMPLEX_STEP, slopes[own], where, unsure[own], scale)


def outputs(compiled: CompiledMechanism, at: State) -> Iterator[Deviation]:
    """Outputs do not depend on earlier calls, and their derivatives by complex steps are those by differences."""
    rng, system, names = np.random.default_rng(1), compiled.complex_system(), [v.name for v in compiled.outputs]
    dq, dv = rng.normal(size=system.n), rng.normal(size=system.n)
    terms = compiled.system.allocate_terms()

    def moved(shift: float) -> Array:
        q, out = at.q.copy(), np.zeros(len(names))
        compiled.system.apply(q, shift * dq)
        compiled.system.fill(at.t, q, at.v + shift * dv, terms)
        compiled.observe(at.t, q, at.v + shift * dv, at.a, at.lam, out)
        return out

    before = moved(0.0)
    slope, unsure = differences(moved)
    yield compare(moved(0.0), before, [f"output {name!r}, read again," for name in names])
    q: Any = at.q.astype(complex)
    step: Any = 1j * COMPLEX_STEP * dq
    system.apply(q, step)
    found = compiled.observe_complex(system, at.t, q, at.v + 1j * COMPLEX_STEP * dv, at.a, at.lam)
    where = [f"derivative of output {name!r}" for name in names]
    yield compare(found.imag / COMPLEX_STEP, slope, where, unsure, float(np.abs(before).max(initial=0.0)))


IDENTITIES: dict[str, Callable[[CompiledMechanism, State], Iterator[Deviation]]] = {
    "positions, velocities and accelerations": motions,
    "kinetic energy and mass matrix": mass_matrix,
    "derivatives of constraints": constraint_rates,
    "energy, potential and power": energy_rate,
    "complex steps": complex_derivatives,
    "outputs": outputs,
}
