"""Check of the parameters of static friction of sheets."""

from __future__ import annotations

from mbfmu.mechanics.numbers import not_negative, positive
from mbfmu.util.errors import UserError


def check_static(
    key: str, what: str, static: float | None, friction: float, stribeck: float | None, deflection: float | None
) -> float:
    """Return the coefficient of static friction that a contact or a nip has.

    Parameters
    ----------
    key, what
        Name of the argument, and name of the contact or nip, for messages.
    static, friction
        Coefficients of static friction and of sliding; None: the same.
    stribeck
        Slip velocity at which static friction decreases to that of sliding, m/s; None: not given.
    deflection
        Displacement before sliding, m; None: friction does not stick.

    Raises
    ------
    UserError
        A value is invalid, or one is given without those that it requires.
    """
    if stribeck is not None:
        positive(f"stribeck of {what}", stribeck)
    if static is None:
        return float(friction)
    if not_negative(f"{key} of {what}", static) < friction:
        raise UserError(
            f"{key} of {what} is {static!r}; allowed: at least the coefficient of sliding friction, {friction!r}"
        )
    if static == friction:
        return float(friction)
    if friction == 0.0:
        raise UserError(
            f"{key} of {what} is {static!r} without friction of sliding; allowed: 0. Give both coefficients"
        )
    if deflection is None:
        raise UserError(
            f"{key} of {what} is {static!r} without a deflection; allowed: the coefficient of sliding friction, "
            f"{friction!r}. Give a deflection: only friction that sticks may be larger at rest"
        )
    if stribeck is None:
        raise UserError(
            f"stribeck of {what} is not given; give the slip velocity (m/s) at which static friction decreases to that "
            "of sliding"
        )
    return float(static)
