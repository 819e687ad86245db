"""First-order states of a mechanism: filters, controllers, currents."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mbfmu.mechanics.kind import check_element_type
from mbfmu.mechanics.loads.base import FirstOrderState
from mbfmu.mechanics.loads.state_equation import StateEquation
from mbfmu.mechanics.quantities import check_names_of_quantities
from mbfmu.mechanics.sensors import Sensor, StateRate, StateValue
from mbfmu.util.units import rate_unit

from .loading import Acting, Loading


class StateHandle:
    """Handle of a first-order state that :meth:`.Mechanism.state` returns: source of sensors, and argument of laws.

    Attributes
    ----------
    name
        Name, unique among the states.
    unit
        Unit of its value.
    mechanism
        Mechanism that it is part of.
    """

    is_state = True

    def __init__(self, name: str, unit: str, mechanism: Any) -> None:
        self.name, self.unit, self.mechanism = name, unit, mechanism

    def value(self) -> Sensor:
        """Return its value, in the unit of the state."""
        return StateValue(unit=self.unit, item=self)

    def rate(self) -> Sensor:
        """Return its rate z', in the unit of the state per second."""
        return StateRate(unit=rate_unit(self.unit), item=self)


class States(Loading):
    """Base of :class:`.Mechanism`: first-order states."""

    def state(
        self,
        name: str,
        rate: Any,
        *,
        uses: Mapping[str, Any] | None = None,
        start: float = 0.0,
        nominal: float = 1.0,
        unit: str = "1",
    ) -> StateHandle:
        """Add a first-order state z with the equation z' = g(t, z, ...), such as a filter or a motor current.

        Parameters
        ----------
        name
            Unique name among the states.
        rate
            Rate g in units of the state per second: function or expression of the time ``t`` (s), of the state's own
            value ``z`` and of the names in ``uses``, in any order: ``"(angle - z) / 0.05"``.
        uses
            Other quantities in the rate by their names: numbers, signals, inputs, functions of time, other states, and
            sensors of positions and velocities, such as ``{"angle": arm.angle()}``.
        start
            Value at the start of a run.
        nominal
            Typical size of the state, in its unit, 1e-50 to 1e50: its absolute tolerance is the tolerance of the solver
            times it.
        unit
            Unit in the notation of FMI, such as ``"A"`` or ``"rad"``; ``"1"``: none.

        Returns
        -------
        StateHandle
            Handle of the state: laws of other states and of :class:`.JointForce` use it, and its sensors are outputs.

        Raises
        ------
        UserError
            The name is used already, a number or the unit is invalid, or the law is not one of its quantities.
        """
        self._new_name("state", name, [acting.name for acting in self.state_equations])
        what = f"state {name!r}"
        declared = FirstOrderState(name=name, unit=unit, start=start, nominal=nominal)
        given = {} if uses is None else uses
        check_names_of_quantities(what, given)
        self._check_quantities(what, given)
        equation = StateEquation(state=declared, rate=rate, uses=dict(given))
        check_element_type(what, equation, StateEquation)
        self.state_equations.append(Acting(what, equation, (), name))
        return StateHandle(name, unit, self)
