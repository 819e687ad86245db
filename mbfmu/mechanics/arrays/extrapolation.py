"""Loads whose stress can be extrapolated, for statics; see :class:`solvers.extrapolation.StressExtrapolation`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.kind import kernel_of

from .compile import CompiledElements


class ExtrapolatedStress:
    """Loads with a kernel ``extrapolate``, see :mod:`mbfmu.mechanics.loads.base`.

    Parameters
    ----------
    mechanism
        Mechanism.
    elements
        Its elements, compiled.
    data
        Arrays and state as kernels take them.
    """

    def __init__(self, mechanism: Mechanism, elements: CompiledElements, data: Any) -> None:
        kinds = {type(acting.load): None for acting in mechanism.loads() if kernel_of(acting.load, "extrapolate")}
        self._tables = [(kernel_of(kind, "extrapolate"), elements.table(kind)) for kind in kinds]
        self._data = data

    def __bool__(self) -> bool:
        """Whether there are any."""
        return bool(self._tables)

    def extrapolate(self) -> None:
        """See :class:`solvers.extrapolation.StressExtrapolation`."""
        for extrapolate, table in self._tables:
            extrapolate(table, *self._data)

    @contextmanager
    def imposed(self) -> Iterator[None]:
        """See :class:`solvers.extrapolation.StressExtrapolation`."""
        self._set(1)
        try:
            yield
        finally:
            self._set(0)

    def _set(self, is_extrapolated: int) -> None:
        for _, table in self._tables:
            table["is_extrapolated"] = is_extrapolated
