"""Blocks that are evaluated at equal intervals of time; in between their outputs are held or follow their rates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mbfmu.mechanics.sensors import Sensor

    Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SampledBlock:
    """A block whose first-order states jump at the times k T, k = 0, 1, 2, ...

    With the inputs u at this time the outputs become y = C x + D u, rounded to whole multiples of the ``quantum``,
    and the states x become A x + B u. Between two samples the states s = (x, y) are constant, or follow s' = R s.

    Parameters
    ----------
    name
        Name of the block.
    period
        Interval T, s.
    states
        Names of its first-order states: x (n,), then y (p,).
    inputs
        Sensors of the inputs u (m,).
    A, B, C, D
        Matrices (n, n), (n, m), (p, n) and (p, m).
    quantum
        Step of the outputs; 0: they are not rounded.
    rates
        Matrix R (n + p, n + p), 1/s; None: zero.
    """

    name: str
    period: float
    states: tuple[str, ...]
    inputs: tuple[Sensor, ...]
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    quantum: float
    rates: Matrix | None = None

    def sample(self, values: Any, u: Any) -> Matrix:
        """Return the next values of its states (n + p,) from the present ones and from the inputs u (m,)."""
        x = values[: len(self.A)]
        y = self.C @ x + self.D @ u
        if self.quantum:
            y = self.quantum * np.floor(y / self.quantum + 0.5)
        found: Matrix = np.append(self.A @ x + self.B @ u, y)
        return found
