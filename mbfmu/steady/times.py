"""The time of a steady state: signals at their ends, or at the start of a run at their values at t = 0.

A signal that drives a joint may move at constant speed in a steady state. One that scales a load has to be constant.
"""

from __future__ import annotations

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.dispatch import signal as signal_at
from mbfmu.mechanics.signals import Function, InUse
from mbfmu.util.errors import EquilibriumError

REST_TOLERANCE = 1e-6  # change of a drive by its speed and acceleration within its pace, in units of its coordinate


def finish(name: str, compiled: CompiledMechanism) -> None:
    """Set all signals of the model ``name`` to their ends.

    Raises
    ------
    EquilibriumError
        A load does not end at a constant value, or a drive at a constant speed.
    """
    for own in compiled.signals(compiled.data):
        own.signal.run_on(own)
    for body, speed, constant in compiled.drives.speeds():
        if not constant:
            raise EquilibriumError(
                f"the drive of {body!r} has no constant speed (now {speed:g}); allowed: "
                "a constant speed, or a RunUp or a Step to one"
            )
    for what, load in compiled.magnitudes():
        if not load.is_constant:
            raise EquilibriumError(
                f"the {what} is {describe(load)}, which does not end at a constant value, so that {name!r} has no "
                "steady state; allowed: a number, an input, or a Step, Ramp or Table that ends at a constant value. "
                "Give one of these; a run can start from the balance at t = 0 (start_at_equilibrium)"
            )


def hold_start(compiled: CompiledMechanism) -> None:
    """Hold all signals at their values at t = 0, except drives at constant speed.

    Raises
    ------
    EquilibriumError
        A drive is neither at constant speed nor at rest at t = 0.
    """
    signals, arrays = compiled.signals(compiled.data), compiled.kernel_data.arrays
    now = [signal_at(own.number, 0.0, arrays) for own in signals]
    held = {own.number for own in signals if not own.signal.operands(own)}
    for body, size, term in compiled.drives.terms():
        if term.steady()[1]:
            held -= {member.number for member in term.members()}
            continue
        _, speed, acceleration = now[term.number]
        pace = term.time_scale(size)
        if max(abs(speed) * pace, abs(acceleration) * pace * pace) > REST_TOLERANCE * size:
            raise EquilibriumError(
                f"the drive of {body!r} is {describe(term)} with the speed {speed:.4g} and the acceleration "
                f"{acceleration:.4g} at t = 0, so that a run cannot start in a steady state; allowed: constant speed, "
                "or rest without acceleration, as a RunUp or a Step that begins at t = 0 or later has. Change the "
                "drive, or do not use start_at_equilibrium"
            )
    for k in held:
        signals[k].signal.hold(signals[k], now[k][0])


def describe(own: InUse) -> str:
    """Return what kind of signal this is, as text: of a sum or a product the first part that changes."""
    part = next((member for member in own.members() if not member.is_constant), own)
    kind = "function of time" if isinstance(part.signal, Function) else type(part.signal).__name__
    named = f"an {kind}" if kind[0] in "AEIOU" else f"a {kind}"
    return named if part is own else f"a {type(own.signal).__name__} with {named}"
