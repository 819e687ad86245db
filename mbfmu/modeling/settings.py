"""How a model is integrated: what a scene, the command line and an FMU say of the solver."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mbfmu.util.errors import UserError, require_arguments, suggest
from solvers import Options
from solvers.steppers import (
    SOLVER_NAMES,
    UNLISTED_SOLVERS,
    describe_order_refusal,
    is_solver,
    solver_name,
    solver_names,
)

from .parameters import check, declared, parameter, span

if TYPE_CHECKING:
    from .model import Model

AUTO = "auto"  # of the solvers: the one that :mod:`mbfmu.session.solver_selection` takes for the model
MIN_ABSOLUTE_TOLERANCE = 1e-15  # absolute tolerance: numbers of size one are no finer


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the integration.

    Parameters
    ----------
    **given
        Values of settings by name, as listed with their descriptions by ``mbfmu models``; others keep their defaults.
        A solver or a tolerance that is not given is that of the model which is simulated or exported.

    Raises
    ------
    UserError
        There is no such setting, or its value is not allowed.
    """

    solver: str = parameter("ida", choices=(*SOLVER_NAMES, AUTO), unlisted=UNLISTED_SOLVERS, doc="Integration method")
    tolerance: float = parameter(1e-6, min=1e-12, max=1e-2, doc="Relative tolerance of the solver")
    absolute_tolerance: float = parameter(
        0.0, min=0.0, max=1.0, doc="Absolute tolerance relative to nominal values; 0: equal to the relative tolerance"
    )
    max_order: int = parameter(
        0, min=0, max=12, doc="Maximum order, 1 to 12 (ida: 1 to 5); 0: the largest (ida with sheets: 2)"
    )
    max_steps: int = parameter(100_000, min=1, doc="Maximum number of steps between two communication points")
    max_step: float = parameter(0.0, unit="s", min=0.0, doc="Maximum step size; 0: no limit")
    input_interpolation: str = parameter(
        "hold",
        choices=("hold", "linear"),
        doc="Interpolation of loads between communication points: constant (hold) or linear extrapolation",
    )
    start_at_equilibrium: bool = parameter(False, doc="Start in the steady state nearest to the start values")
    energy_check: bool = parameter(True, doc="Check of the energy balance during the run")
    _given: ClassVar[frozenset[str]] = frozenset()  # names of the settings that were given, set for each object

    def __new__(cls, **given: Any) -> Self:
        """Check the names of the settings; raises UserError."""
        require_arguments(cls, given)
        made = super().__new__(cls)
        object.__setattr__(made, "_given", frozenset(given))
        return made

    def __post_init__(self) -> None:
        """Check the names and numbers; raises UserError."""
        for p in declared(Settings):
            object.__setattr__(self, p.name, check_setting(p.name, getattr(self, p.name)))
        if refused := describe_order_refusal(self.solver, self.max_order or None):
            raise UserError(refused)
        if 0.0 < self.absolute_tolerance < MIN_ABSOLUTE_TOLERANCE:
            raise UserError(
                f"absolute_tolerance is {self.absolute_tolerance!r}; allowed: 0, or {MIN_ABSOLUTE_TOLERANCE:g} to 1"
            )

    def for_model(self, model: Model) -> Settings:
        """Return the settings with the solver and the tolerance of a model, if these were not given.

        Parameters
        ----------
        model
            Model that is simulated or exported.
        """
        own: dict[str, Any] = {"solver": model.default_solver, "tolerance": model.tolerance}
        return replace(self, **{name: value for name, value in own.items() if name not in self._given})

    def options(self, duration: float = Options.duration) -> Options:
        """Return the options of the stepper.

        Parameters
        ----------
        duration
            Time of the whole run, s.
        """
        return Options(
            rtol=self.tolerance,
            atol=self.absolute_tolerance or None,
            max_step=self.max_step or inf,
            max_order=self.max_order or None,
            max_steps=self.max_steps,
            energy_check=self.energy_check,
            duration=duration,
        )


def check_setting(name: str, value: Any) -> Any:
    """Return the value of one setting in its type; raises UserError if it is invalid whatever the others are."""
    if name == "solver":
        return check_solver(value)
    declaration = next(p for p in declared(Settings) if p.name == name)
    try:
        return check("the settings", declaration, value)
    except UserError as error:
        finite = "finite, " if declaration.max == inf and not declaration.choices else ""
        raise UserError(f"{name} is {value!r}; allowed: {finite}{span(declaration)}") from error


def check_solver(solver: Any) -> str:
    """Return the name of a solver that is given by its name or as a class; raises UserError if there is none."""
    try:
        name = solver_name(solver)
    except ValueError as error:
        raise UserError(str(error)) from error
    if name != AUTO and not is_solver(name):
        raise UserError(f"solver is {name!r}{suggest(name, offered_solvers())}")
    return str(name)


def offered_solvers() -> tuple[str, ...]:
    """Return the names of the solvers that are offered to users, with those of installed packages."""
    return (*solver_names(), AUTO)
