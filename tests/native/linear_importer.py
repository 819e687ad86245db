"""Importing tools that request derivatives: of FMI 2.0, and of FMI 3.0."""

from __future__ import annotations

from ctypes import c_double, c_size_t, c_uint, c_void_p
from typing import Any

import fmpy
import numpy as np
from binding import OK
from exchange_models import ExportedModels
from fmpy.fmi3 import FMU3Model
from importer import Importer
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Linear:
    """Derivatives of an instance for model exchange, by states and inputs."""

    def __init__(self, own: Importer, constant: tuple[str, ...] = ()) -> None:
        described = own.binary.description
        self.own = own
        self.slopes = [unknown.variable.valueReference for unknown in described.derivatives]
        self.states = [unknown.variable.derivative.valueReference for unknown in described.derivatives]
        inputs = [v for v in described.modelVariables if v.causality == "input" and v.name not in constant]
        self.inputs, self.input_names = [v.valueReference for v in inputs], [v.name for v in inputs]
        self.outputs = [own.references[name] for name in own.outputs]

    @property
    def unknowns(self) -> list[int]:
        """All unknowns."""
        return [*self.slopes, *self.outputs]

    def along(self, seed: Array, unknowns: list[int] | None = None) -> Array:
        """Return the derivatives along a direction of all states and inputs."""
        status, found = directional(self.own.fmu, unknowns or self.unknowns, [*self.states, *self.inputs], seed)
        assert status == OK, self.own.binary.logged
        return found

    def matrix(self) -> Array:
        """Return the derivatives by all states and inputs."""
        return np.array([self.along(unit) for unit in np.eye(len(self.states) + len(self.inputs))]).T

    def evaluate(self, t: float, x: Array, u: Array) -> Array:
        """Return the derivatives of the states and the outputs."""
        self.own.inputs = {name: lambda _, value=value: value for name, value in zip(self.input_names, u, strict=True)}
        return np.concatenate((self.own.derivatives(t, x), self.own.read(t, x)))

    def differences(self, t: float, x: Array, u: Array, h: Array) -> Array:
        """Return the derivatives by all states and inputs by central differences with the steps h."""
        weights, columns = ((3, 1.0 / 60.0), (2, -9.0 / 60.0), (1, 45.0 / 60.0)), []
        for k, step in enumerate(h):
            e = np.zeros(len(x) + len(u))
            e[k] = step
            change = np.zeros(len(self.unknowns))
            for n, w in weights:
                for side in (n, -n):
                    change += np.sign(side) * w * self.evaluate(t, x + side * e[: len(x)], u + side * e[len(x) :])
            columns.append(change / step)
        self.evaluate(t, x, u)
        return np.array(columns).T


def directional(fmu: Any, unknowns: list[int], knowns: list[int], seed: Any) -> tuple[int, Array]:
    """Call fmi2GetDirectionalDerivative; return the status and the result."""
    found = (c_double * len(unknowns))()
    sides = [((c_uint * len(side))(*side), c_size_t(len(side))) for side in (unknowns, knowns)]
    status = fmu.call("GetDirectionalDerivative", *sides[0], *sides[1], (c_double * len(knowns))(*seed), found)
    return status, np.array(found)


def on_the_constraints(own: Importer, spread: float, seed: int = 1) -> Array:
    """Return states near the start, projected onto the constraints by an event."""
    x = own.states() + spread * np.random.default_rng(seed).normal(size=own.count)
    own.place(0.0, x)
    own.event()
    return own.states()


def relative_errors(found: Array, expected: Array) -> Array:
    """Return the largest error of every row, relative to its largest entry, or to a part of that of the matrix."""
    size = np.maximum(np.abs(expected).max(axis=1), 1e-3 * np.abs(expected).max())
    return np.abs(found - expected).max(axis=1) / size


class Third:
    """An instance of FMI 3.0 for model exchange, after its initialization."""

    def __init__(self, models: ExportedModels, name: str, model: Any, folder: Any) -> None:
        path = models.export(name, model, 3)
        self.described = fmpy.read_model_description(str(path))
        fmpy.extract(str(path), unzipdir=str(folder))
        identifier = self.described.modelExchange.modelIdentifier
        token = self.described.instantiationToken
        self.fmu = FMU3Model(guid=token, unzipDirectory=str(folder), modelIdentifier=identifier, instanceName="one")
        self.fmu.instantiate()
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.slopes = [unknown.variable.valueReference for unknown in self.described.derivatives]
        self.states = [unknown.variable.derivative.valueReference for unknown in self.described.derivatives]
        self.outputs = [unknown.variable for unknown in self.described.outputs]

    def derivative(self, kind: str, unknowns: list[int], knowns: list[int], seed: Array, count: int) -> Array:
        """Call fmi3GetDirectionalDerivative or fmi3GetAdjointDerivative."""
        found = np.zeros(count)
        sides = [((c_uint * len(side))(*side), c_size_t(len(side))) for side in (unknowns, knowns)]
        function = self.fmu.dll[f"fmi3Get{kind}Derivative"]
        values = [(v.ctypes.data_as(c_void_p), c_size_t(len(v))) for v in (np.ascontiguousarray(seed), found)]
        assert function(c_void_p(self.fmu.component), *sides[0], *sides[1], *values[0], *values[1]) == OK
        return found
