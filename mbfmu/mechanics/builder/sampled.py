"""Sampled blocks: sample-and-hold, quantizers, and controllers in discrete time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from mbfmu.mechanics.loads.base import FirstOrderState
from mbfmu.mechanics.numbers import array_of, finite, not_negative, positive
from mbfmu.mechanics.sampling import SampledBlock
from mbfmu.mechanics.sensors import Sensor
from mbfmu.mechanics.transfer import Matrix, matrix
from mbfmu.util.errors import UserError

from .blocks import BlockHandle
from .controllers import Controllers


class SampledHandle(BlockHandle):
    """Handle of a sampled block: its outputs are held between the samples.

    Attributes
    ----------
    held
        Number of outputs.
    """

    held = 1

    def value(self, k: int = 0) -> Sensor:
        """Return an output, in its unit.

        Parameters
        ----------
        k
            Number of the output, from 0; only a :meth:`.Mechanism.sampled_system` has several.

        Raises
        ------
        UserError
            There is no such output.
        """
        if k not in range(self.held):
            raise UserError(f"block {self.name!r} has no output {k!r}; allowed: 0 to {self.held - 1}")
        return super().value(k)


class Sampled(Controllers):
    """Base of :class:`.Mechanism`: sampled blocks."""

    def __init__(self) -> None:
        super().__init__()
        self.sampled: list[SampledBlock] = []

    def sample_hold(
        self,
        name: str,
        source: Any,
        *,
        period: float,
        quantum: float = 0.0,
        start: float = 0.0,
        nominal: float = 1.0,
        unit: str = "1",
    ) -> SampledHandle:
        """Add a sample-and-hold block, with a quantizer if a quantum is given.

        Parameters
        ----------
        name
            Unique name among the blocks.
        source
            Input.
        period
            Interval T between the samples, s. They are taken at 0, T, 2 T, ...; at the time of an event after its
            actions.
        quantum
            Step of the output, in its unit: the sample is rounded to the nearest whole multiple. 0: it is not rounded.
        start
            Output before the first sample, which is taken at the start of a run.
        nominal, unit
            As for :meth:`lag`.

        Returns
        -------
        SampledHandle
            Handle of the block.

        Raises
        ------
        UserError
            As for :meth:`lag`; or the period is not positive.
        """
        given: dict[str, Any] = {"start_output": [start], "nominal": nominal, "units": [unit]}
        none = np.zeros((0, 1))
        return self._sampled(
            name, [source], period, np.zeros((0, 0)), none, none.T, np.ones((1, 1)), quantum=quantum, **given
        )

    def sampled_system(
        self,
        name: str,
        sources: Sequence[Any],
        *,
        period: float,
        A: Any,
        B: Any,
        C: Any,
        D: Any = None,
        quantum: float = 0.0,
        start: Sequence[float] | None = None,
        start_output: Sequence[float] | None = None,
        nominal: float = 1.0,
        units: Sequence[str] = (),
    ) -> SampledHandle:
        """Add a linear system in discrete time, such as a digital controller.

        At the times k T the outputs become y = C x + D u, and the states x become A x + B u. The outputs are held until
        the next sample.

        Parameters
        ----------
        name
            Unique name among the blocks.
        sources
            Inputs u, 1 to 8.
        period
            Interval T between the samples, s, see :meth:`sample_hold`.
        A, B, C
            Matrices (n, n), (n, inputs) and (outputs, n).
        D
            Matrix (outputs, inputs); None: zero.
        quantum
            Step of all outputs, see :meth:`sample_hold`.
        start, start_output
            States and outputs before the first sample; None: zero.
        nominal
            Typical size of states and outputs.
        units
            Units of the outputs; empty: none. The states have no unit.

        Returns
        -------
        SampledHandle
            Handle of the block; ``value(k)`` is output k.

        Raises
        ------
        UserError
            As for :meth:`state_space`; or the period is not positive.
        """
        what = f"block {name!r}"
        if not isinstance(sources, list | tuple):
            raise UserError(f"sources of {what} are {sources!r}; allowed: a list of inputs")
        n, p = len(np.atleast_1d(array_of(f"A of {what}", A))), len(np.atleast_1d(array_of(f"C of {what}", C)))
        m = len(sources)
        a, b = matrix(f"A of {what}", A, (n, n)), matrix(f"B of {what}", B, (n, m))
        c = matrix(f"C of {what}", C, (p, n))
        d = np.zeros((p, m)) if D is None else matrix(f"D of {what}", D, (p, m))
        before = [0.0] * n if start is None else list(start)
        outputs = [0.0] * p if start_output is None else list(start_output)
        if len(before) != n or len(outputs) != p or len(units) not in (0, p):
            raise UserError(
                f"{what} has {n} states and {p} outputs, and is given {len(before)} values of start, {len(outputs)} of "
                f"start_output and {len(units)} units; allowed: one for each"
            )
        return self._sampled(
            name, sources, period, a, b, c, d,
            quantum=quantum, start=before, start_output=outputs, nominal=nominal, units=units or ["1"] * p,
        )  # fmt: skip

    def _sampled(
        self,
        name: str,
        sources: Sequence[Any],
        period: float,
        A: Any,
        B: Any,
        C: Any,
        D: Any,
        *,
        quantum: float,
        start: Sequence[float] = (),
        start_output: Sequence[float],
        nominal: float,
        units: Sequence[str],
        rates: Matrix | None = None,
    ) -> SampledHandle:
        """Add a block whose states are x and y, and whose outputs are y and u; ``rates``: see
        :class:`.sampling.SampledBlock`.
        """
        what, (p, m), n = f"block {name!r}", D.shape, len(A)
        step, T = not_negative(f"quantum of {what}", quantum), positive(f"period of {what}", period)
        names = [*(f"x{k + 1}" for k in range(n)), *(f"y{k + 1}" for k in range(p))]
        starts = [finite(f"start of {what}", value) for value in (*start, *start_output)]
        state_units = [*["1"] * n, *units]
        states = [
            FirstOrderState(name=own, unit=unit, start=value, nominal=nominal)
            for own, unit, value in zip(names, state_units, starts, strict=True)
        ]
        outputs, direct = np.eye(p + m, n + p, n), np.zeros((p + m, m))
        outputs[p:], direct[p:] = 0.0, np.eye(m)
        flow = np.zeros((n + p, n + p)) if rates is None else rates, np.zeros((n + p, m))
        given = {"source" if m == 1 else f"source {k}": source for k, source in enumerate(sources)}
        all_units = [*units, *["1"] * m]
        made = cast(
            "SampledHandle",
            self._linear(name, given, *flow, outputs, direct, None, [], all_units, states=states, handle=SampledHandle),
        )
        made.held = p
        inputs = tuple(BlockHandle.value(made, p + k) for k in range(m))
        state_names = tuple(f"{name}.{own}" for own in names)
        self.sampled.append(SampledBlock(name, T, state_names, inputs, A, B, C, D, step, rates))
        return made
