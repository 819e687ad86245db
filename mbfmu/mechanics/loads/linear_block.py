"""Linear blocks with limits: filters, transfer functions and controllers as first-order states.

    w = C x + D u,    y = w within its limits, else the limit,    x' = A x + B u + K (y - w)

The inputs u are signals, sensors, first-order states and outputs of other blocks. K is the gain of back-calculation,
which keeps the integral of a controller from growing while its output is limited (Astrom and Hagglund 2006, Advanced
PID Control, section 3.5, ISBN 978-1-55617-942-6).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.quantities import Quantity, place_of
from mbfmu.mechanics.quantity_kinds import MAX_QUANTITIES
from mbfmu.mechanics.reading import read_quantity
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Integers, Record, i8

from .base import FirstOrderState, Load

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State

Matrix = NDArray[np.float64]


class LinearBlockRecord(Record):
    """Parameters of :class:`LinearBlock`. A, B, C, D, K, lower and upper limits follow each other in Arrays.numbers."""

    state: i8  # place of the first state in State.v
    n: i8  # number of states, inputs and outputs
    m: i8
    p: i8
    first: i8  # number of A[0, 0]
    limited: i8  # 1: an output has a limit
    kinds: Annotated[Integers, (MAX_QUANTITIES,)]  # of the inputs
    places: Annotated[Integers, (MAX_QUANTITIES,)]


@kernel
def unlimited_output(block: LinearBlockRecord, j: int, t: float, arrays: Arrays, state: State) -> float:
    """w_j. Inputs that the output does not contain are not read."""
    n, m, p, values = block.n, block.m, block.p, arrays.numbers
    c = block.first + n * (n + m) + j * n
    d = block.first + n * (n + m) + p * n + j * m
    total = 0.0 * state.time[0]
    for i in range(n):
        total += values[c + i] * state.v[block.state + i]
    for k in range(m):
        if values[d + k].real != 0.0:
            total += values[d + k] * read_quantity(block.kinds[k], block.places[k], t, arrays, state)
    return total


@kernel
def limited_output(block: LinearBlockRecord, j: int, w: float, arrays: Arrays) -> float:
    """y_j of w_j."""
    n, m, p = block.n, block.m, block.p
    at = block.first + (n + p) * (n + m) + n * p + j
    lower, upper = arrays.numbers[at], arrays.numbers[at + p]
    if w.real < lower.real:
        return lower + 0.0 * w
    if w.real > upper.real:
        return upper + 0.0 * w
    return w


@kernel
def apply(block: LinearBlockRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    n, m, p, values, x = block.n, block.m, block.p, arrays.numbers, block.state
    if n == 0:
        return
    a, b, gain = block.first, block.first + n * n, block.first + (n + p) * (n + m)
    for k in range(m):
        u = read_quantity(block.kinds[k], block.places[k], t, arrays, state)
        for i in range(n):
            state.Q[x + i] += values[b + i * m + k] * u
    for i in range(n):
        for k in range(n):
            state.Q[x + i] += values[a + i * n + k] * state.v[x + k]
    if block.limited == 1:
        for j in range(p):
            w = unlimited_output(block, j, t, arrays, state)
            excess = limited_output(block, j, w, arrays) - w
            for i in range(n):
                state.Q[x + i] += values[gain + i * p + j] * excess


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearBlock(Load):
    """A linear block with limits, which the methods of :class:`.Mechanism` for blocks create.

    Parameters
    ----------
    what
        Name in messages, such as ``"block 'filter'"``.
    inputs
        Inputs u (m,).
    A, B, C, D
        Matrices (n, n), (n, m), (p, n) and (p, m).
    first_order_states
        States x (n,).
    K
        Gain (n, p) of back-calculation, 1/s; None: zero.
    lower, upper
        Limits of the outputs (p,); None: infinite.
    """

    record = LinearBlockRecord
    n_bodies = 0
    apply = apply

    what: str
    inputs: tuple[Quantity, ...]
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    first_order_states: tuple[FirstOrderState, ...]
    K: Matrix | None = None
    lower: Matrix | None = None
    upper: Matrix | None = None

    @property
    def states(self) -> tuple[FirstOrderState, ...]:
        """Return its states."""
        return self.first_order_states

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the matrices and the inputs."""
        self.write(record, site, site.first_state)

    def write(self, record: Any, site: Attachment, first_state: int) -> None:
        """Write all fields; the first state is at this place."""
        p, n = self.C.shape
        gain = np.zeros((n, p)) if self.K is None else self.K
        lower = np.full(p, -np.inf) if self.lower is None else self.lower
        upper = np.full(p, np.inf) if self.upper is None else self.upper
        record["state"], record["n"], record["m"], record["p"] = first_state, n, self.D.shape[1], p
        record["limited"] = np.any(np.isfinite([lower, upper])) and np.any(gain)
        parts = (self.A, self.B, self.C, self.D, gain, lower, upper)
        record["first"] = site.numbers(np.concatenate([np.ravel(part) for part in parts]))
        for k, quantity in enumerate(self.inputs):
            record["kinds"][k], record["places"][k] = quantity.kind, place_of(quantity, site, self.what)
