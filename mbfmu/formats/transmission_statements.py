"""Statements that add forces on linear combinations of joint coordinates, such as tendons, and servos with limits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from .description import ImportedTransmission
from .literals import call, number_text

Declare = Callable[[str, float, str, str], str]  # (name, value, unit, text): use of the parameter in the code
Force = Callable[[str, str, list[str]], list[str]]  # (name, force, bodies): lines


class Units(NamedTuple):
    """Units of a force, of its stiffness and of its damping."""

    force: str = "1"
    stiffness: str = "1"
    damping: str = "1"


def transmission_lines(
    own: ImportedTransmission, units: Units, declare: Declare, unique: Callable[[str], str], force: Force
) -> Iterator[str]:
    """Yield the statements of a transmission: blocks that compute the force, and the forces on the joints.

    Parameters
    ----------
    own
        Transmission.
    units
        Units of its force.
    declare
        Function that declares a parameter.
    unique
        Function that returns a name of a block that is not in use.
    force
        Function that returns the statement of a force.
    """
    sources, weights = list[str](), list[str]()
    if own.input:
        signal = f'mb.Input(name="{own.input}", unit="{own.unit}", description="{own.description}")'
        if own.control_limits is not None:
            block = unique(f"{own.name}_control")
            yield from call(
                f"{block} = m.limiter",
                [f'"{block}"', signal, *limit_arguments(own.control_limits), f'unit="{own.unit}"'],
            )
            signal = block
        sources.append(signal)
        weights.append(declare(f"{own.name}_gain", own.gain, units.force, f"Force of {own.name} per unit of its input"))
    for key, value, sensor, unit in (
        ("stiffness", own.stiffness, "coordinate", units.stiffness),
        ("damping", own.damping, "rate", units.damping),
    ):
        if value:
            use = declare(f"{own.name}_{key}", value, unit, f"{key.capitalize()} of {own.name}")
            sources += [f"{body}.{sensor}()" for body in own.bodies]
            weights += [product(-factor, use) for factor in own.factors]
    if own.bias:
        sources.append("1.0")
        weights.append(number_text(own.bias))
    limits = limit_arguments(own.limits) if own.limits is not None else []
    limits += [f'unit="{units.force}"'] if units.force != "1" else []
    total = unique(f"{own.name}_force")
    arguments = [f'"{total}"', f"[{', '.join(sources)}]", f"[{', '.join(weights)}]", *limits]
    yield from call(f"{total} = m.weighted_sum", arguments)
    for body, factor in zip(own.bodies, own.factors, strict=True):
        signal = total
        if factor != 1.0:
            part = unique(f"{own.name}_{body}")
            signal = f'm.weighted_sum("{part}", [{total}], [{number_text(factor)}])'
        name = own.name if len(own.bodies) == 1 else f"{own.name}_{body}"
        yield from force(name, f"mb.JointForce({signal})", [body])


def product(factor: float, use: str) -> str:
    """Return the product of a number and a parameter as code."""
    if abs(factor) == 1.0:
        return use if factor > 0.0 else f"-{use}"
    return f"{number_text(factor)} * {use}"


def limit_arguments(limits: tuple[float, float]) -> list[str]:
    """Return limits as arguments."""
    return [f"lower={number_text(limits[0])}", f"upper={number_text(limits[1])}"]
