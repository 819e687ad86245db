"""Linear blocks: filters, transfer functions, limiters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from mbfmu.mechanics.kind import check_element_type
from mbfmu.mechanics.loads.base import FirstOrderState
from mbfmu.mechanics.loads.linear_block import LinearBlock, Matrix
from mbfmu.mechanics.numbers import array_of, finite, positive
from mbfmu.mechanics.quantities import quantity_of
from mbfmu.mechanics.quantity_kinds import MAX_QUANTITIES
from mbfmu.mechanics.sensors import BlockOutput, Sensor
from mbfmu.mechanics.transfer import matrix, realize, steady_states
from mbfmu.util.errors import UserError

from .expressions import Expressions
from .loading import Acting
from .states import StateHandle

NO_MATRIX = np.zeros((0, 0))


class BlockHandle:
    """Handle of a block: argument of laws, of forces and of other blocks, and source of sensors.

    Attributes
    ----------
    name
        Name, unique among the blocks.
    states
        First-order states of the block; their full names begin with that of the block.
    block
        Matrices and inputs.
    units
        Unit of each output.
    mechanism
        Mechanism that it is part of.
    """

    is_block = True

    def __init__(self, name: str, block: LinearBlock, units: Sequence[str], mechanism: Any) -> None:
        self.name, self.block, self.units, self.mechanism = name, block, tuple(units), mechanism
        self.states = tuple(StateHandle(f"{name}.{own.name}", own.unit, mechanism) for own in block.states)
        self._number = len(mechanism.blocks)
        self._outputs = tuple(BlockOutput(unit=unit, item=self, component=j) for j, unit in enumerate(units))

    @property
    def index(self) -> int:
        """Number among the loads of the mechanism."""
        loads = sum(1 for _ in self.mechanism.loads())
        return loads - len(self.mechanism.blocks) + self._number

    def value(self, k: int = 0) -> Sensor:
        """Return an output, in the unit of the block.

        Parameters
        ----------
        k
            Number of the output, from 0; only a :meth:`.Mechanism.state_space` block has several.

        Raises
        ------
        UserError
            There is no such output.
        """
        if k not in range(len(self._outputs)):
            raise UserError(f"block {self.name!r} has no output {k!r}; allowed: 0 to {len(self._outputs) - 1}")
        return self._outputs[k]


def sensor_of(given: Any) -> Any:
    """Return the sensor of the output of a block or of the value of a state; all else as it is."""
    return given.value() if isinstance(given, BlockHandle | StateHandle) else given


class Blocks(Expressions):
    """Base of :class:`.Mechanism`: linear blocks.

    The inputs of blocks are numbers, signals, inputs, functions or expressions of time, first-order states, other
    blocks and their outputs, sensors of positions and velocities, and expressions of these (:meth:`expression`).
    """

    def lag(
        self,
        name: str,
        source: Any,
        *,
        time_constant: float,
        gain: float = 1.0,
        start_input: float = 0.0,
        nominal: float = 1.0,
        unit: str = "1",
    ) -> BlockHandle:
        """Add a first-order lag: T y' + y = gain u, with the input u and the output y.

        Parameters
        ----------
        name
            Unique name among the blocks.
        source
            Input u.
        time_constant
            Time constant T, s.
        gain
            Gain, in units of the output per unit of the input.
        start_input
            Constant input before the start of the run: y starts at ``gain`` times this value.
        nominal
            Typical size of the output, in its unit: the absolute tolerance of the states is the tolerance of the solver
            times it.
        unit
            Unit of the output in the notation of FMI.

        Returns
        -------
        BlockHandle
            Handle of the block.

        Raises
        ------
        UserError
            The name is used already, a number or the unit is invalid, or the input is not one of its quantities.
        """
        what = f"block {name!r}"
        T = positive(f"time_constant of {what}", time_constant)
        A, C = np.array([[-1.0 / T]]), np.ones((1, 1))
        B = np.array([[finite(f"gain of {what}", gain) / T]])
        return self._linear(name, {"source": source}, A, B, C, np.zeros((1, 1)), [start_input], [nominal], [unit])

    def transfer_function(
        self,
        name: str,
        source: Any,
        *,
        numerator: Sequence[float],
        denominator: Sequence[float],
        start_input: float = 0.0,
        nominal: float = 1.0,
        unit: str = "1",
    ) -> BlockHandle:
        """Add a proper transfer function, of any order.

        Parameters
        ----------
        name
            Unique name among the blocks.
        source
            Input.
        numerator, denominator
            Coefficients of the polynomials of s, that of the highest power first: ``[1], [0.1, 1]`` is 1 / (0.1 s + 1).
            The numerator has at most the degree of the denominator.
        start_input
            Constant input before the start of the run: the states start in the steady state of this input.
        nominal, unit
            As for :meth:`lag`.

        Returns
        -------
        BlockHandle
            Handle of the block. Its states ``x1``, ``x2``, ... are those of the controllable canonical form, scaled to
            the size of the output.

        Raises
        ------
        UserError
            As for :meth:`lag`; or the transfer function is improper.
        """
        A, B, C, D = realize(f"block {name!r}", numerator, denominator)
        nominals = [nominal] * len(A)
        return self._linear(name, {"source": source}, A, B, C, D, [start_input], nominals, [unit])

    def state_space(
        self,
        name: str,
        sources: Sequence[Any],
        *,
        A: Any,
        B: Any,
        C: Any,
        D: Any = None,
        start_input: Sequence[float] | None = None,
        nominal: Sequence[float] | float = 1.0,
        units: Sequence[str] = (),
    ) -> BlockHandle:
        """Add a linear system x' = A x + B u with the outputs y = C x + D u.

        Parameters
        ----------
        name
            Unique name among the blocks.
        sources
            Inputs u, 1 to 8.
        A, B, C
            Matrices (n, n), (n, inputs) and (outputs, n).
        D
            Matrix (outputs, inputs); None: zero.
        start_input
            Constant inputs before the start of the run: the states start in the steady state of these; None: at zero.
        nominal
            Typical size of all states, or of each state.
        units
            Units of the outputs; empty: none. The states have no unit.

        Returns
        -------
        BlockHandle
            Handle of the block; ``value(k)`` is output k, and its states are ``x1``, ``x2``, ...

        Raises
        ------
        UserError
            As for :meth:`lag`; or the shapes of the matrices do not fit.
        """
        what = f"block {name!r}"
        if not isinstance(sources, list | tuple):
            raise UserError(f"sources of {what} are {sources!r}; allowed: a list of inputs")
        n, outputs = len(np.atleast_1d(array_of(f"A of {what}", A))), len(np.atleast_1d(array_of(f"C of {what}", C)))
        inputs = len(sources)
        a, b = matrix(f"A of {what}", A, (n, n)), matrix(f"B of {what}", B, (n, inputs))
        c = matrix(f"C of {what}", C, (outputs, n))
        d = np.zeros((outputs, inputs)) if D is None else matrix(f"D of {what}", D, (outputs, inputs))
        sizes = [nominal] * n if np.ndim(nominal) == 0 else list(cast("Sequence[float]", nominal))
        given = {f"source {k}": source for k, source in enumerate(sources)}
        before = [0.0] * inputs if start_input is None else list(start_input)
        if len(sizes) != n or len(before) != inputs or len(units) not in (0, outputs):
            raise UserError(
                f"{what} has {n} states, {inputs} inputs and {outputs} outputs, and is given {len(sizes)} nominal "
                f"values, {len(before)} values of start_input and {len(units)} units; allowed: one for each"
            )
        return self._linear(
            name, given, a, b, c, d, before, cast("list[float]", sizes), units or ["1"] * outputs, state_unit="1"
        )

    def limiter(self, name: str, source: Any, *, lower: float, upper: float, unit: str = "1") -> BlockHandle:
        """Add a limiter: the output is the input, but not less than ``lower`` and not more than ``upper``.

        Parameters
        ----------
        name
            Unique name among the blocks.
        source
            Input.
        lower, upper
            Limits, in the unit of the input.
        unit
            Unit of input and output in the notation of FMI.

        Returns
        -------
        BlockHandle
            Handle of the block, which has no state.

        Raises
        ------
        UserError
            As for :meth:`lag`; or the lower limit is not less than the upper one.
        """
        limits = limits_of(f"block {name!r}", lower, upper)
        one, row = np.ones((1, 1)), np.zeros((0, 1))
        return self._linear(name, {"source": source}, NO_MATRIX, row, row.T, one, [0.0], [], [unit], limits=limits)

    def weighted_sum(
        self,
        name: str,
        sources: Sequence[Any],
        weights: Sequence[float],
        *,
        lower: float | None = None,
        upper: float | None = None,
        unit: str = "1",
    ) -> BlockHandle:
        """Add a weighted sum of inputs within limits: y = w1 u1 + w2 u2 + ..., as of a servo with a limited force.

        Parameters
        ----------
        name
            Unique name among the blocks.
        sources
            Inputs u, 1 to 8.
        weights
            Weight of each input, in units of the output per unit of the input.
        lower, upper
            Limits of the output, in its unit; None: no limit.
        unit
            Unit of the output in the notation of FMI.

        Returns
        -------
        BlockHandle
            Handle of the block, which has no state.

        Raises
        ------
        UserError
            As for :meth:`lag`; or the numbers of inputs and weights differ; or the lower limit is not less than the
            upper one.
        """
        what = f"block {name!r}"
        if not isinstance(sources, list | tuple):
            raise UserError(f"sources of {what} are {sources!r}; allowed: a list of inputs")
        D = matrix(f"weights of {what}", [weights], (1, len(sources)))
        given = {f"source {k}": source for k, source in enumerate(sources)}
        limits, B, C = limits_of(what, lower, upper), np.zeros((0, len(sources))), np.zeros((1, 0))
        return self._linear(name, given, NO_MATRIX, B, C, D, [0.0] * len(sources), [], [unit], limits=limits)

    def _linear(
        self,
        name: str,
        inputs: Mapping[str, Any],
        A: Matrix,
        B: Matrix,
        C: Matrix,
        D: Matrix,
        start_input: Sequence[float] | None,
        nominal: Sequence[float],
        units: Sequence[str],
        *,
        limits: tuple[float, float] | None = None,
        K: Matrix | None = None,
        states: Sequence[FirstOrderState] = (),
        state_unit: str | None = None,
        handle: type[BlockHandle] = BlockHandle,
    ) -> BlockHandle:
        """Add a block and return its handle."""
        what = f"block {name!r}"
        self._new_name("block", name, [acting.name for acting in self.blocks])
        if not 1 <= len(inputs) <= MAX_QUANTITIES:
            raise UserError(f"{what} has {len(inputs)} inputs; allowed: 1 to {MAX_QUANTITIES}")
        self._check_quantities(what, inputs)
        if start_input is not None:
            before = [finite(f"start_input of {what}", value) for value in start_input]
            starts = steady_states(what, A, B, before)
            states = [
                FirstOrderState(name=f"x{k + 1}", unit=state_unit or units[0], start=start, nominal=size)
                for k, (start, size) in enumerate(zip(starts, nominal, strict=True))
            ]
        block = LinearBlock(
            what=what,
            inputs=tuple(quantity_of(what, key, source) for key, source in inputs.items()),
            A=A,
            B=B,
            C=C,
            D=D,
            first_order_states=tuple(states),
            K=K,
            lower=None if limits is None else np.full(len(C), limits[0]),
            upper=None if limits is None else np.full(len(C), limits[1]),
        )
        check_element_type(what, block, LinearBlock)
        made = handle(name, block, units, self)
        self.blocks.append(Acting(what, block, (), name))
        return made


def limits_of(what: str, lower: float | None, upper: float | None) -> tuple[float, float] | None:
    """Return the limits of an output; None: it has none."""
    if lower is None and upper is None:
        return None
    low = -np.inf if lower is None else finite(f"lower of {what}", lower)
    high = np.inf if upper is None else finite(f"upper of {what}", upper)
    if low >= high:
        raise UserError(f"lower of {what} is {lower!r}, upper {upper!r}; allowed: lower less than upper")
    return low, high
