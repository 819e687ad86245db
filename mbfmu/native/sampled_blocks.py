"""Sampled blocks of native FMUs, as :mod:`mbfmu.session.sampled_blocks` has them in Python."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.arrays.compiled_mechanism import CompiledMechanism
from mbfmu.mechanics.recursions.dynamics import watch_sensors
from mbfmu.session.sampled_blocks import EQUAL_TIME_SPACINGS
from solvers.compiled.kernel import kernel
from solvers.resolution import spacing
from solvers.system import Array


class SampledMemory(NamedTuple):
    """The sampled blocks of a run."""

    counts: NDArray[np.int64]  # (blocks,) number of samples that are over
    numbers: Array  # periods and quanta (blocks,), then A, B, C and D of each block
    periods: Array  # parts of it, s
    quanta: Array
    sizes: NDArray[np.int64]  # (blocks, 3) numbers of states, inputs and outputs
    first_numbers: NDArray[np.int64]  # (blocks,) place of A in the numbers
    first_states: NDArray[np.int64]  # (blocks,) place of the first state in ``states``
    first_inputs: NDArray[np.int64]  # (blocks,) place of the first input in ``parts``
    states: NDArray[np.int64]  # places of the states of all blocks in the velocities
    parts: NDArray[np.int64]  # numbers of the parts that are the inputs of all blocks
    u: Array  # scratch: the inputs

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays to save."""
        return [self.counts, self.numbers]


def sampled_numbers(mechanism: Any) -> Array:
    """Return the numbers of the sampled blocks of a mechanism: see :class:`SampledMemory`."""
    blocks = mechanism.sampled
    matrices = [np.ravel(part) for block in blocks for part in (block.A, block.B, block.C, block.D)]
    first = [block.period for block in blocks], [block.quantum for block in blocks]
    return np.concatenate([np.zeros(0), *first, *matrices])


def sampled_structure(mechanism: Any) -> list[tuple[Any, ...]]:
    """Return what native FMUs have of the sampled blocks as it is at the export: all but their numbers."""
    return [(block.name, block.A.shape, block.D.shape) for block in mechanism.sampled]


def sampled_memory(compiled: CompiledMechanism) -> SampledMemory:
    """Return the sampled blocks of a compiled mechanism."""
    blocks, i = compiled.mechanism.sampled, np.int64
    places = {name: k for k, name in enumerate(compiled.system.coordinate_names)}
    sizes = np.array([(len(block.A), *block.D.shape[::-1]) for block in blocks], i).reshape(len(blocks), 3)
    n, m, p = sizes.T
    lengths, count = n * n + n * m + p * n + p * m, len(blocks)
    firsts = (np.append(0, np.cumsum(own))[:count].astype(i) for own in (lengths, n + p, m))
    first_numbers, first_states, first_inputs = firsts
    states = np.array([places[name] for block in blocks for name in block.states], i)
    numbers = sampled_numbers(compiled.mechanism)
    first = np.zeros(count, i), numbers, numbers[:count], numbers[count : 2 * count], sizes
    where = first_numbers + 2 * count, first_states, first_inputs, states, compiled.sampled
    return SampledMemory(*first, *where, np.zeros(len(compiled.sampled)))


def no_sampled_memory() -> SampledMemory:
    """Return memory of the types that all have, without meaning."""
    z, i = np.zeros, np.int64
    whole = z((1, 3), i), z(1, i), z(1, i), z(1, i), z(1, i), z(1, i)
    return SampledMemory(z(1, i), z(2), z(1), z(1), *whole, z(1))


@kernel
def begin_samples(sampled: SampledMemory, t: float) -> None:
    """Begin at t, s: samples of times before are over."""
    slack = EQUAL_TIME_SPACINGS * spacing(t)
    for k in range(sampled.periods.shape[0]):
        sampled.counts[k] = max(0, int(np.ceil((t - slack) / sampled.periods[k])))


@kernel
def next_sample_time(sampled: SampledMemory) -> float:
    """Time of the next sample, s; infinite: there is none."""
    found = np.inf
    for k in range(sampled.periods.shape[0]):
        found = min(found, sampled.counts[k] * sampled.periods[k])
    return float(found)


@kernel
def matrix_row(matrix: Any, first: int, row: int, count: int, values: Any, places: Any, begin: int) -> float:
    """Product of a row of a matrix (rows, count) that begins at ``first``, with values at ``count`` places."""
    total = 0.0
    for i in range(count):
        total += matrix[first + row * count + i] * values[places[begin + i]]
    return total


@kernel
def matrix_row_of_inputs(matrix: Any, first: int, row: int, count: int, u: Any, begin: int) -> float:
    """Product of a row of a matrix (rows, count) that begins at ``first``, with the inputs of a block."""
    total = 0.0
    for i in range(count):
        total += matrix[first + row * count + i] * u[begin + i]
    return total


@kernel
def fill_sample_jump(instance: Any, slack: float) -> bool:
    """Take the samples of the reported time, up to ``slack`` (s) later, and fill the jump of the velocities and states;
    False: there is none.
    """
    sampled, t, v, dv = instance.sampled, instance.clock[0], instance.v, instance.dv
    if not next_sample_time(sampled) <= t + slack:
        return False
    watch_sensors(t, instance.q, v, sampled.parts, instance.session.data, sampled.u)
    for i in range(dv.shape[0]):
        dv[i] = 0.0
    values = sampled.numbers
    for k in range(sampled.periods.shape[0]):
        if not sampled.counts[k] * sampled.periods[k] <= t + slack:
            continue
        n, m, p = sampled.sizes[k, 0], sampled.sizes[k, 1], sampled.sizes[k, 2]
        x, u = sampled.first_states[k], sampled.first_inputs[k]
        a = sampled.first_numbers[k]
        b, c = a + n * n, a + n * n + n * m
        d = c + p * n
        for i in range(n):
            own = matrix_row(values, a, i, n, v, sampled.states, x)
            own += matrix_row_of_inputs(values, b, i, m, sampled.u, u)
            place = sampled.states[x + i]
            dv[place] = own - v[place]
        for j in range(p):
            own = matrix_row(values, c, j, n, v, sampled.states, x)
            own += matrix_row_of_inputs(values, d, j, m, sampled.u, u)
            if sampled.quanta[k] > 0.0:
                own = sampled.quanta[k] * np.floor(own / sampled.quanta[k] + 0.5)
            place = sampled.states[x + n + j]
            dv[place] = own - v[place]
        sampled.counts[k] += 1
    return True
