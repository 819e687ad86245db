"""One call of every user-defined kernel with checks, of array bounds above all, before the first call without them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.dispatch import BIAS, CLEARANCE, LONGEST_STEP, MISPLACEMENT, MONITOR, POTENTIAL, POWER
from mbfmu.mechanics.records import MAX_KERNELS, Arrays, Data, State, copy_state
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import COMPILED, bounds_checked, records
from solvers.compiled.record_view import aligned_bytes
from solvers.compiled.tuple_pointer import pin

from .own_joints import check_joints
from .tables import CalledKernel

GUARD_SIZE, GUARD_BYTE = 4 * 2**20, 0xA5  # bytes behind the scratch memory, and what they contain
OWN_PACKAGES = ("mbfmu.", "fmus.")  # modules whose kernels have separate tests


class KernelUse(NamedTuple):
    """A kernel where the mechanism calls it."""

    what: str  # of messages
    kernel: int  # place in ``Arrays.kernels``
    at: int  # place of the record in ``Arrays.memory``
    arguments: tuple[Any, ...] | None  # None: by the words of its signature


def check_bounds(mechanism: Mechanism, called: list[CalledKernel | None], data: Data) -> None:
    """Raise UserError if a user-defined kernel uses an index outside an array, or writes scratch memory that its
    ``fill`` has not requested; ``data`` is left as it is.

    Compiled kernels check neither: such a kernel would overwrite memory of something else.
    """
    foreign = {
        k for k, own in enumerate(called) if own is not None and not own.function.__module__.startswith(OWN_PACKAGES)
    }
    if not foreign:
        return
    given: Any = data.arrays
    arrays, state = Arrays(*(array.copy() for array in given)), copy_state(data.state)
    state = state._replace(scratch=guarded(state.scratch))
    state.bodies["A"][:] = np.eye(3)
    for use in _uses(mechanism, arrays, state):
        own = called[use.kernel] if use.kernel in foreign else None
        if own is not None:
            _call(use, own, arrays, state)
            _check_guard(use, own, state.scratch, len(data.state.scratch))
    check_joints(mechanism, called, foreign, arrays, copy_state(data.state))


def guarded(scratch: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return scratch memory with a guard behind it, which no kernel may write."""
    found = aligned_bytes(len(scratch) + GUARD_SIZE)
    found[len(scratch) :] = GUARD_BYTE
    return found


def _check_guard(use: KernelUse, own: CalledKernel, scratch: NDArray[np.uint8], size: int) -> None:
    """Raise UserError if a kernel has written behind the ``size`` bytes that were requested."""
    if np.any(scratch[size:] != GUARD_BYTE):
        raise UserError(
            f"{use.what}: kernel {own.function.__name__!r} ({own.function.__module__}) writes scratch memory that its "
            "fill has not requested; allowed: the fields of the dtype that is passed to site.scratch. Store the place "
            "that it returns in the record, and use the same dtype in scratch_record"
        )


def _by_words(own: CalledKernel, arrays: Arrays, state: State) -> tuple[Any, ...]:
    """Return what a kernel of a part is called with."""
    known = {word: records(1, dtype)[0] for word, dtype in own.words}
    known |= {"time": 0.0, "arrays": pin(arrays), "state": pin(state), "lam": np.zeros(len(arrays.kept))}
    return tuple(known[word] for word in own.signature.partition(" -> ")[0].split(", "))


def _call(use: KernelUse, own: CalledKernel, arrays: Arrays, state: State) -> None:
    arguments = _by_words(own, arrays, state) if use.arguments is None else use.arguments
    record = arrays.memory[use.at : use.at + own.record.itemsize].view(own.record)
    try:
        with np.errstate(all="ignore"):
            _checked(own.function)(record[0] if COMPILED else record.view(np.recarray)[0], *arguments)
    except IndexError as error:
        name = own.function.__name__
        raise UserError(
            f"{use.what}: kernel {name!r} ({own.function.__module__}) uses an index outside an array: {error}; use the "
            "indices from its record and its arguments, and run with NUMBA_DISABLE_JIT=1 to see the line"
        ) from error
    except (ArithmeticError, ValueError):  # of plain Python, at a state that is none: compiled kernels write nan
        pass


@cache
def _checked(function: Any) -> Any:
    return bounds_checked(function)


def _uses(mechanism: Mechanism, arrays: Arrays, state: State) -> Iterator[KernelUse]:
    """Yield every use of a kernel that is called in real numbers."""
    # without a compiler kernels get the tuples themselves
    a, s, t = pin(arrays), pin(state), 0.0
    for body, own in zip(mechanism.bodies[1:], arrays.bodies[1:], strict=True):
        what, at, q, v = f"joint of body {body.name!r}", int(own["at"]), int(own["qi"]), int(own["vi"])
        yield KernelUse(what, int(own["kind"]), at, (q, s))
        yield KernelUse(what, int(own["kind"]) + BIAS, at, (q, v, s))
    for cut, own in zip(mechanism.cuts, arrays.cuts, strict=True):
        ends = state.bodies[int(own["a"])], state.bodies[int(own["b"])]
        yield KernelUse(f"cut {cut.name!r}", int(own["kind"]), int(own["at"]), (*ends, int(own["row"]), a, s))
    for coupling, own in zip(mechanism.couplings, arrays.couplings, strict=True):
        q_b = float(state.q[int(own["qb"])])
        yield KernelUse(f"coupling {coupling.name!r}", int(own["kind"]), int(own["at"]), (q_b, a))
    for acting, own in zip(mechanism.loads(), arrays.loads, strict=True):
        at, kind = int(own["at"]), int(own["kind"])
        yield KernelUse(acting.what, kind, at, (t, a, s))
        yield KernelUse(acting.what, kind + POTENTIAL, at, (a, s))
        yield KernelUse(acting.what, kind + POWER, at, (t, a, s))
        yield KernelUse(acting.what, kind + MONITOR, at, (a, s))
        yield KernelUse(acting.what, kind + MISPLACEMENT, at, (a, s))
        yield KernelUse(acting.what, kind + CLEARANCE, at, (a, s))
    for own in arrays.signals:
        yield KernelUse("a signal", int(own["kind"]), int(own["at"]), (t, a))
        yield KernelUse("a signal", int(own["kind"]) + LONGEST_STEP, int(own["at"]), (t, a))
    for own in arrays.parts:
        for k in range(MAX_KERNELS):
            yield KernelUse("a part", int(own["kind"]) + k, int(own["at"]), None)
    names = [f"output {name!r}" for name, *_ in mechanism.outputs]
    for what, own in zip(names, arrays.sensors, strict=False):  # the last two are energies
        yield KernelUse(what, int(own["kind"]), int(own["at"]), (np.zeros(len(arrays.kept)), a, s))
