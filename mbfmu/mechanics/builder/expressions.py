"""Expressions of time, inputs, states, blocks and sensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mbfmu.mechanics.quantities import check_names_of_quantities
from mbfmu.mechanics.sensors import Expression, Sensor
from mbfmu.util.units import read_unit

from .states import States


class Expressions(States):
    """Base of :class:`.Mechanism`: expressions of other quantities."""

    def expression(self, law: Any, *, uses: Mapping[str, Any] | None = None, unit: str = "1") -> Sensor:
        """Function or expression of time, inputs, states, blocks and other sensors, such as the power of a motor.

        Parameters
        ----------
        law
            Function or expression of the time ``t`` (s) and of the names in ``uses``, in any order:
            ``"torque * rate"``. A name has no dots: ``"k * (target - angle)"`` with
            ``uses={"k": 3.0, "target": target, "angle": crank.angle()}``.
        uses
            Quantities by their names: numbers, signals, inputs, functions of time, states, blocks, other expressions
            and sensors, 8 at most with ``t``.
        unit
            Unit of the result in the notation of FMI; ``"1"``: none. Numbers are not converted.

        Returns
        -------
        Sensor
            An output. Without sensors of forces and accelerations also the quantity of an :meth:`event`, and an
            argument of laws, of forces and of blocks.

        Raises
        ------
        UserError
            The unit or the law is invalid, a name is not known or not used, or a quantity is of another mechanism.
        """
        read_unit(unit)
        given = {} if uses is None else uses
        check_names_of_quantities("an expression", given)
        made = Expression(unit=unit, law=law, uses=dict(given))
        self._check_quantities(made.what, made.uses)
        return made
