"""The variables of an FMU: how a model's parameters, inputs, outputs and the solver's settings are declared."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pythonfmu import Boolean, Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real
from pythonfmu import Integer as FmiInteger
from pythonfmu import String as FmiString

from mbfmu.audit import VARIABLES
from mbfmu.mechanics import Plant
from mbfmu.model import Model, Parameter
from mbfmu.simulation import Settings, Simulation, unique

from .description import Quantity, QuantityReal, complete

COUNTERS = {
    "steps": "steps taken",
    "rejected": "steps rejected",
    "rhs_evals": "evaluations of the equations of motion",
    "partition_switches": "changes between LU and projection partition",
    "restarts": "restarts of the integrator",
    "stability_limited": "steps of adams and hybrid whose length stability set, and not accuracy",
}


class Interface(Fmi2Slave):  # type: ignore[misc]
    """Declares the variables and holds their values: reals by value reference in one buffer."""

    model: ClassVar[Model]
    settings: ClassVar[Settings] = Settings()

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.simulation: Simulation | None = None
        self.message = ""

    def _take(self, reference: int, value: float) -> None:
        raise NotImplementedError

    def _take_text(self, name: str, value: str) -> None:
        raise NotImplementedError

    def register(self, plant: Plant) -> None:
        """Declare every variable; value references count them in this order, which is the FMU's interface."""
        self._texts = {"solver": self.settings.solver, "partition": self.settings.partition}
        self._parameters: dict[int, Parameter] = {}
        self._reals: list[tuple[int, float]] = []
        for declared in self.model.parameters():
            self._parameter(declared)
        s = self.settings
        self._settings = {
            "tolerance": self._real(
                "tolerance", Quantity(min=1e-12, max=1e-2), "relative tolerance of the solver", s.tolerance
            ),
            "max_step": self._real("max_step", Quantity(unit="s", min=0.0), "largest step; 0: no limit", s.max_step),
            "start_at_equilibrium": self._whole(
                Boolean,
                "start_at_equilibrium",
                "start in the steady state next to the given start",
                s.start_at_equilibrium,
            ),
            "audit": self._whole(Boolean, "audit", "hold the energy against the work all along", s.audit),
        }
        self._string("solver", "ida, adams, hybrid or adams-lu", parameter=True)
        self._string("partition", "of adams: projection, lu or hybrid", parameter=True)
        self._inputs = [
            self._real(v.name, Quantity(unit=v.unit), v.description, v.start, causality=Fmi2Causality.input)
            for v in plant.inputs.variables
        ]
        self._motions = {r for k, r in enumerate(self._inputs) if plant.inputs.moves_support(k)}
        self._outputs = np.array(
            [
                self._output(v.name, Quantity(unit=v.unit, nominal=v.nominal), v.description)
                for v in (*plant.outputs, *VARIABLES)
            ],
            dtype=int,
        )
        self._counters = {name: self._counter(f"solver.{name}", text) for name, text in COUNTERS.items()}
        self._string(
            "solver.message",
            "what went wrong, a stop or a lost energy balance, and what to try; or empty",
        )
        unique(variable.name for variable in self.vars.values())
        self._buffer = np.zeros(len(self.vars))
        for reference, start in self._reals:
            self._buffer[reference] = start

    def setting_reference(self, name: str) -> int:
        """Return the value reference of a numerical setting."""
        return self._settings[name]

    def _parameter(self, p: Parameter) -> None:
        start = getattr(self.model, p.name)
        if p.structural:  # it decides which variables there are
            self._constant(p, start)
            return
        variability = Fmi2Variability.tunable if p.tunable else Fmi2Variability.fixed
        if isinstance(p.default, float):
            quantity = Quantity(unit=p.unit, min=p.min, max=p.max)
            reference = self._real(p.name, quantity, p.doc, start, variability=variability)
        else:
            kind = Boolean if isinstance(p.default, bool) else FmiInteger
            reference = self._whole(kind, p.name, p.doc, start, variability=variability)
        self._parameters[reference] = p

    def _constant(self, p: Parameter, value: Any) -> None:
        kinds = {bool: Boolean, int: FmiInteger, str: FmiString}
        reference = len(self.vars)
        self.register_variable(
            kinds.get(type(value), Real)(
                p.name,
                causality=Fmi2Causality.local,
                variability=Fmi2Variability.constant,
                initial=Fmi2Initial.exact,
                description=f"{p.doc} (fixed at export)",
                getter=lambda: value,
            ),
            nested=False,
        )
        if isinstance(value, float):
            self._reals.append((reference, value))

    def _whole(
        self,
        kind: Any,
        name: str,
        text: str,
        start: float,
        *,
        variability: Fmi2Variability = Fmi2Variability.fixed,
    ) -> int:
        reference = len(self.vars)
        self.register_variable(
            kind(
                name,
                causality=Fmi2Causality.parameter,
                variability=variability,
                description=text,
                getter=lambda: self._buffer[reference],
                setter=lambda value: self._take(reference, value),
            ),
            nested=False,
        )
        self._reals.append((reference, float(start)))
        return reference

    def _real(
        self,
        name: str,
        quantity: Quantity,
        text: str,
        start: float,
        *,
        causality: Fmi2Causality = Fmi2Causality.parameter,
        variability: Fmi2Variability = Fmi2Variability.fixed,
    ) -> int:
        if causality == Fmi2Causality.input:
            variability = Fmi2Variability.continuous
        reference = len(self.vars)
        variable = QuantityReal(
            name,
            quantity,
            causality=causality,
            variability=variability,
            description=text,
            getter=lambda: None,
            setter=lambda value: self._take(reference, value),
        )
        self.register_variable(variable, nested=False)
        self._reals.append((reference, start))
        return reference

    def _output(self, name: str, quantity: Quantity, text: str) -> int:
        reference = len(self.vars)
        variable = QuantityReal(
            name,
            quantity,
            causality=Fmi2Causality.output,
            variability=Fmi2Variability.continuous,
            initial=Fmi2Initial.calculated,
            description=text,
            getter=lambda: None,
        )
        self.register_variable(variable, nested=False)
        return reference

    def _counter(self, name: str, text: str) -> int:
        reference = len(self.vars)
        self.register_variable(
            FmiInteger(
                name,
                causality=Fmi2Causality.output,
                variability=Fmi2Variability.discrete,
                initial=Fmi2Initial.calculated,
                description=text,
                getter=lambda: self._count(name.removeprefix("solver.")),
            ),
            nested=False,
        )
        return reference

    def _string(self, name: str, text: str, *, parameter: bool = False) -> None:
        getter = (lambda: self._texts[name]) if parameter else (lambda: self.message)
        self.register_variable(
            FmiString(
                name,
                causality=Fmi2Causality.parameter if parameter else Fmi2Causality.output,
                variability=Fmi2Variability.fixed if parameter else Fmi2Variability.discrete,
                initial=None if parameter else Fmi2Initial.calculated,
                description=text,
                getter=getter,
                setter=lambda value: self._take_text(name, value),
            ),
            nested=False,
        )

    def _count(self, name: str) -> int:
        return int(getattr(self.simulation.statistics, name)) if self.simulation else 0

    def to_xml(self, model_options: dict[str, str] | None = None) -> Any:
        """Return the model description."""
        return complete(super().to_xml(model_options or {}), list(self.vars.values()), bool(self._inputs))
