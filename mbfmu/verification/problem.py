"""Declaration of a problem: its mechanism, its source, and the reference that a run is compared with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import Mechanism

Array = NDArray[np.float64]
Solution = Callable[[Array, Array], Array]  # start (s,), times (k,) in s -> values (k, n) of the quantities

NUDGE = 1e-7  # relative change of the start by which the growth of errors is measured
DENSE_SOLVERS = ("adams", "hybrid", "radau", "ida", "esdirk")


class Source(NamedTuple):
    """Publication that a problem, its data or its reference is from."""

    authors: str
    year: int
    title: str
    link: str = ""  # address: DOI, or the page of a library of problems

    @property
    def key(self) -> str:
        """Surname of the first author and year."""
        return f"{self.authors.split(',')[0].split()[-1]} {self.year}"

    def __str__(self) -> str:
        return f"{self.authors} ({self.year}): {self.title}"


class Reference(NamedTuple):
    """Values that a run is compared with.

    Attributes
    ----------
    values
        Quantities (k, n) at the times of comparison.
    sensitivity
        Deviation (k, n) of the quantities per relative error of the state, in the units of the quantities; it does not
        decrease with time.
    uncertainty
        Largest error of ``values``.
    """

    values: Array
    sensitivity: Array
    uncertainty: float


@dataclass(frozen=True)
class Exact:
    """Motion that is known independently of mbfmu.

    Attributes
    ----------
    solution
        Returns the quantities (k, n) at times (k,), s, for a start (s,).
    start
        Start (s,) of the solution: positions, velocities, or whatever determines the motion.
    scales
        Sizes (s,) of the numbers of the start, to which errors of the solver are relative.
    uncertainty
        Largest error of the solution in the unit of the quantities.
    rough
        Solution with smaller accuracy and effort, for sensitivities; None: there is none.
    """

    solution: Solution
    start: tuple[float, ...]
    scales: tuple[float, ...]
    uncertainty: float
    rough: Solution | None = None

    def at(self, times: Array) -> Reference:
        """Return the reference at times (k,), s.

        The sensitivity is the sum over all numbers of the start of the change that a change of this number causes. A
        run commits errors at every step, so that its error is a multiple of tolerance times sensitivity.
        """
        start, scales = np.array(self.start), np.array(self.scales)
        values, solution = self.solution(start, times), self.rough or self.solution
        unchanged, sensitivity = solution(start, times), np.zeros_like(values)
        for nudge in NUDGE * np.diag(scales):
            sensitivity += np.abs(solution(start + nudge, times) - unchanged) / NUDGE
        return Reference(values, np.maximum.accumulate(sensitivity), self.uncertainty)


class ExactLike(Protocol):
    """What a motion is compared with."""

    def at(self, times: Array) -> Reference:
        """Return the reference at times (k,), s."""
        ...


@dataclass(frozen=True, kw_only=True)
class Problem:
    """What all problems declare.

    Attributes
    ----------
    name
        Unique name, by which ``--only`` selects.
    description
        Mechanism with its data, a sentence or more.
    sources
        Publications; empty: the problem was devised for this suite.
    quantity
        Quantity that is compared, a noun phrase.
    unit
        Its unit.
    derivation
        How the reference is obtained, a noun phrase.
    build
        Returns the mechanism.
    is_quick
        Whether ``--quick`` contains the problem.
    """

    name: str
    description: str
    sources: tuple[Source, ...] = ()
    quantity: str
    unit: str
    derivation: str
    build: Callable[[], Mechanism]
    is_quick: bool = True

    @property
    def source_keys(self) -> str:
        """First authors and years of the sources; empty if there are none."""
        return ", ".join(source.key for source in self.sources)


@dataclass(frozen=True, kw_only=True)
class Motion(Problem):
    """Simulation, whose outputs are compared over time.

    Attributes
    ----------
    outputs
        Names of outputs, in the order of the columns of the reference.
    exact
        Returns the reference.
    stop_time
        End of the simulation, s.
    only_end
        Whether the reference is known at the end only.
    solvers
        Solvers that are run if they accept the model.
    model_error
        Difference between the mechanism and the idealized one of the reference, in the unit of the quantity, such as
        the deflection of an elastic bristle in place of Coulomb friction.
    settings
        Further settings of the simulation.
    """

    outputs: tuple[str, ...]
    exact: Callable[[], ExactLike]
    stop_time: float
    only_end: bool = False
    solvers: tuple[str, ...] = DENSE_SOLVERS
    model_error: float = 0.0
    settings: Mapping[str, Any] | None = None


@dataclass(frozen=True, kw_only=True)
class Value(Problem):
    """Numbers that follow from a mechanism without a simulation, such as a steady state or a natural frequency.

    Attributes
    ----------
    measure
        Returns the numbers (n,) of a mechanism.
    method
        Function of mbfmu that is verified, such as ``equilibrium``; in the place of the solver in the report.
    reference
        Returns the numbers (n,) of the reference.
    uncertainty
        Largest relative error of the reference.
    allowed
        Largest relative error of a right result: rounding, or the error of a mesh.
    """

    measure: Callable[[Mechanism], Array]
    method: str
    reference: Callable[[], Array]
    uncertainty: float = 1e-12
    allowed: float = 1e-7
