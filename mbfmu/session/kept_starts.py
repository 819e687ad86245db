"""Compiled mechanisms and their starts, which are kept for later runs of the same model.

Compilation and the analysis of the start take several times as long as many runs of small models. Both depend on the
mechanism that the model builds, on the settings and on the values of inputs alone. A later run with the same of them
gets the compiled mechanism of an earlier one, whose memory is set to its contents at the start, so that all results
are the same bit for bit.

The model is built for every run, since ``build`` may depend on more than the parameters. Mechanisms are compared by
their content. Those that contain functions or user-defined types are not kept: their code may depend on anything.
"""

from __future__ import annotations

import pickle
from collections import OrderedDict
from collections.abc import Hashable, Sequence
from hashlib import sha256
from io import BytesIO
from types import BuiltinFunctionType, FunctionType, MethodType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.mechanics.arrays.given_inputs import GivenInputs
from mbfmu.mechanics.builder.arrangement import arrange
from mbfmu.mechanics.builder.short_forces import declare_short_forces
from mbfmu.modeling.model import MechanismModel, Model
from mbfmu.modeling.settings import Settings
from mbfmu.steady.state import Equilibrium
from mbfmu.util.diagnostics import Diagnostic
from solvers import Options

from .solver_selection import SolverChoice

Array = NDArray[np.float64]

MAX_KEPT_STARTS = 4
# packages of functions that pickle calls to construct objects
CONSTRUCTING_PACKAGES = ("numpy", "copyreg", "builtins", "enum", "operator", "types", "collections")

_kept: OrderedDict[Hashable, KeptStart] = OrderedDict()  # starts of runs that have ended, the latest last


class Start(NamedTuple):
    """What is found about the start of a run before its solver is created."""

    q: Array  # (nq,) closed
    v: Array  # (n,)
    solver_choice: SolverChoice
    options: Options
    steady_state: Equilibrium | None  # in which the run starts
    diagnostics: tuple[list[Diagnostic], list[Diagnostic], list[Diagnostic]]  # of it, of the elements, of the order


class MemoryImage:
    """Contents of arrays at one time.

    Parameters
    ----------
    arrays
        Contiguous arrays.
    """

    def __init__(self, arrays: Sequence[NDArray[Any]]) -> None:
        self._views = [array.reshape(-1).view(np.uint8) for array in arrays if array.nbytes]
        self._contents = [view.copy() for view in self._views]

    def restore(self) -> None:
        """Let the arrays have these contents."""
        for view, content in zip(self._views, self._contents, strict=True):
            view[:] = content


class KeptStart:
    """A compiled mechanism, and what a run has found about its start.

    Parameters
    ----------
    compiled
        Compiled mechanism that no other run uses.
    given_inputs
        Inputs that it was compiled with.
    key
        What a later run must have in common with this one; None: it is not kept.

    Attributes
    ----------
    start
        What was found before the solver was created; None: nothing yet.
    noted
        Notes and warnings on the model, the solver and the start.
    """

    def __init__(
        self, compiled: CompiledMechanism, given_inputs: GivenInputs | None, key: Hashable | None = None
    ) -> None:
        self.compiled, self.given_inputs, self._key = compiled, given_inputs, key
        self.start: Start | None = None
        self.noted: tuple[Diagnostic, ...] = ()
        self._images: list[MemoryImage] = []

    def remember_start(self, start: Start) -> None:
        """Remember what was found, and the memory before the solver is created."""
        self.start = start
        self._remember_memory()

    def remember_diagnostics(self, noted: Sequence[Diagnostic]) -> None:
        """Remember notes and warnings, and the memory at the first communication point."""
        self.noted = tuple(noted)
        self._remember_memory()

    def _remember_memory(self) -> None:
        if self._key is not None:
            data, inputs = self.compiled.data, self.compiled.inputs.own
            arrays = [*data.arrays, *data.state, *inputs.memory(), *inputs.values()]
            self._images.append(MemoryImage([array for array in arrays if isinstance(array, np.ndarray)]))

    def restore_before_solver(self) -> None:
        """Let the compiled mechanism be as it was before the solver was created."""
        self._images[0].restore()

    def restore_diagnosed(self) -> None:
        """Let the compiled mechanism be as it was at the first communication point."""
        self._images[1].restore()

    def keep(self) -> None:
        """Keep it for a later run. The run that used it must have ended, and nothing may refer to it any more.

        It is not kept if events or sampled blocks may have changed the mechanism, or if the model is large: then most
        of the memory is that of the structured tangent, and compilation takes a smaller part of the time.
        """
        mechanism, system = self.compiled.mechanism, self.compiled.system
        if self._key is None or mechanism.events or mechanism.sampled or not system.has_matrices:
            return
        _kept[self._key] = self
        while len(_kept) > MAX_KEPT_STARTS:
            _kept.popitem(last=False)


def take_start(model: Model, settings: Settings, given_inputs: GivenInputs, times: Array) -> KeptStart | None:
    """Return the start of an earlier run that was the same, or else one with a compiled mechanism alone.

    Parameters
    ----------
    model, settings
        What is simulated.
    given_inputs
        Inputs of the run.
    times
        Times of the outputs (k,), s.

    Returns
    -------
    KeptStart or None
        None: there are inputs over time, and :class:`.Simulation` compiles the mechanism.
    """
    if given_inputs.by_name or model.replaced_inputs or type(model).compile is not Model.compile:
        return None
    mechanism = model.built()
    if len(mechanism.bodies) == 1:
        return None  # which is an error
    # of a mechanism that others may change, another one with the same content is not used
    owner = id(mechanism) if mechanism.compiled or isinstance(model, MechanismModel) else None
    if not mechanism.compiled:
        declare_short_forces(mechanism)
        arrange(mechanism)
    mechanism.compiled = True
    content, key = fingerprint_of(mechanism), None
    if content is not None:
        run = float(times[0]), float(times[-1]), model.stop_time, tuple(given_inputs.numbers.items())
        key = content, owner, model.name, settings, *run
        try:
            if kept := _kept.pop(key, None):
                return kept
        except TypeError:  # an input is no number, which is an error
            key = None
    return KeptStart(CompiledMechanism(mechanism, given_inputs), given_inputs, key)


class _ContentPickler(pickle.Pickler):
    """A pickler for comparisons: classes are compared by identity, and code of users cannot be compared."""

    def reducer_override(self, obj: Any) -> Any:
        """Return the identity of a class; raise for types and functions of users."""
        if isinstance(obj, type):
            if _package(obj) not in (*CONSTRUCTING_PACKAGES, "mbfmu", "solvers"):
                raise pickle.PicklingError(f"{obj!r} is a type of a user")
            return _identity, (id(obj),)
        if isinstance(obj, FunctionType | BuiltinFunctionType | MethodType):
            if _package(obj) not in CONSTRUCTING_PACKAGES and obj is not _identity:
                raise pickle.PicklingError(f"{obj!r} is a function")
        return NotImplemented


def _package(obj: Any) -> str:
    """Return the package that defines a type or a function."""
    return (obj.__module__ or "").partition(".")[0]


def _identity(_: int) -> None:
    """Stand for a class in pickled content, which is not loaded."""


def fingerprint_of(mechanism: Mechanism) -> bytes | None:
    """Return a fingerprint of the content of a mechanism, valid while it exists; None: it contains functions or
    types of users.
    """
    content = BytesIO()
    try:
        _ContentPickler(content, pickle.HIGHEST_PROTOCOL).dump(mechanism)
    except (pickle.PicklingError, TypeError, AttributeError, RecursionError):
        return None
    return sha256(content.getvalue()).digest()
