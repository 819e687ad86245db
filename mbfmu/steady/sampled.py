"""Steady states of models with sampled blocks, and their stability.

In a steady state every sample finds the state that the sample before has left: the held outputs and the states of each
block satisfy y = C x + D u and x = A x + B u. Newton's method solves these equations with all others. For it the states
of a block get the rates of the difference quotient,

    x' = (A x + B u - x) / T,    y' = (C x + D u - y) / T,

which are zero in the same states. Stability is not that of these rates, but that of the motion with samples: between
two samples the states s of the linearized model follow s' = F s, where x and y are constant or have the rates of their
block (:class:`.sampling.SampledBlock`); at a sample of some blocks they jump to S s. The map over a common period of
all blocks is the product of these matrices exp(F h) and S; the steady state is stable if its eigenvalues, the
multipliers, are inside the unit circle (Astrom and Wittenmark 1997, Computer-Controlled Systems, chapter 3, ISBN
978-0-13-314899-2).
"""

from __future__ import annotations

from fractions import Fraction
from functools import reduce
from math import lcm

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.loads.linear_block import LinearBlock
from mbfmu.mechanics.sampling import SampledBlock
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import EquilibriumError
from solvers.statics.spectrum import Stability
from solvers.system import Array

MAX_PERIOD_RATIO, PERIOD_RATIO_TOLERANCE = 1000, 1e-9  # of the periods of two blocks, and its relative error
MAX_SAMPLE_TIMES = 10_000  # within a common period


def use_difference_quotients(compiled: CompiledMechanism, name: str) -> None:
    """Let the states of the sampled blocks of a compiled mechanism of model ``name`` have the rates of their difference
    quotients.

    Raises
    ------
    EquilibriumError
        A block rounds its outputs.
    """
    blocks = {block.name: block for block in compiled.mechanism.sampled}
    for block in blocks.values():
        if block.quantum:
            raise EquilibriumError(
                f"block {block.name!r} of model {name!r} rounds its outputs to multiples of {block.quantum:g}: the "
                "search for a steady state needs continuous equations; allowed: sampled blocks without a quantum. Set "
                "quantum to 0, or run the model until it is at rest"
            )
    linear = [acting for acting in compiled.mechanism.loads() if type(acting.load) is LinearBlock]
    records = next((table for table in compiled.tables if table.dtype == LinearBlock.record.dtype), ())
    numbers = compiled.data.arrays.numbers
    for acting, record in zip(linear, records, strict=True):
        if acting.name in blocks:
            own, first = np.hstack(quotients(blocks[acting.name])), int(record["first"])
            n = len(own)
            numbers[first : first + n * n] = own[:, :n].ravel()
            numbers[first + n * n : first + own.size] = own[:, n:].ravel()


def quotients(block: SampledBlock) -> tuple[Array, Array]:
    """Return the matrices (n + p, n + p) of its states and (n + p, m) of its inputs in the rates of a block, 1/s."""
    n, p = len(block.A), len(block.C)
    states = np.hstack((np.vstack((block.A, block.C)), np.zeros((n + p, p)))) - np.eye(n + p)
    return states / block.period, np.vstack((block.B, block.D)) / block.period


def sample_times(periods: Array) -> tuple[Array, NDArray[np.bool_]] | None:
    """Return the times (k,) of all samples in a common period, its end included, in units of the first period, and
    which blocks sample there (k, blocks); None: the periods have no common multiple that is short enough.
    """
    ratios = [Fraction(period / periods[0]).limit_denominator(MAX_PERIOD_RATIO) for period in periods]
    if np.any(np.abs(np.array(ratios, float) * periods[0] - periods) > PERIOD_RATIO_TOLERANCE * periods):
        return None
    common = reduce(lcm, (ratio.denominator for ratio in ratios))
    steps = [int(ratio * common) for ratio in ratios]
    length = reduce(lcm, steps)
    if length == 0 or sum(length // step for step in steps) > MAX_SAMPLE_TIMES:
        return None
    times = sorted({k for step in steps for k in range(step, length + 1, step)})
    return np.array(times) / common, np.array([[k % step == 0 for step in steps] for k in times])


def multipliers(blocks: list[SampledBlock], F: Array, states: list[str]) -> tuple[Array, Array] | None:
    """Return the eigenvalues of the map over a common period, and bounds of their rounding errors; None: there is no
    common period.

    Parameters
    ----------
    blocks
        The sampled blocks.
    F
        State matrix (k, k) with the rates of the difference quotients.
    states
        Names of the states (k,).
    """
    found = sample_times(np.array([block.period for block in blocks]))
    if found is None:
        return None
    jumps, flow = [], F.copy()
    for block in blocks:
        rows = [states.index(name) for name in block.states]
        jump = np.zeros_like(F)
        jump[rows] = block.period * F[rows]
        flow[rows] = 0.0
        if block.rates is not None:
            flow[np.ix_(rows, rows)] = block.rates
        jumps.append(jump)
    total, last, flows = np.eye(len(F)), 0.0, dict[float, Array]()
    for t, due in zip(*found, strict=True):
        h = round(float(t - last), 12)
        if h not in flows:
            flows[h] = scipy.linalg.expm(h * blocks[0].period * flow)
        jump = np.eye(len(F)) + sum(own for own, is_due in zip(jumps, due, strict=True) if is_due)
        total, last = jump @ flows[h] @ total, float(t)
    total = scipy.linalg.matrix_balance(total)[0]  # states have different units
    values, left, right = scipy.linalg.eig(total, left=True)
    conditions = np.abs(np.sum(left.conj() * right, axis=0))
    size = len(F) * np.finfo(float).eps * np.linalg.norm(total, 2)
    return values, size / np.maximum(conditions, size)


def stability_of(values: Array, doubts: Array) -> Stability:
    """Return the stability of a map by its eigenvalues (k,) and bounds of their rounding errors (k,)."""
    beyond = np.abs(values) - 1.0
    on_circle = np.abs(beyond) <= doubts
    if np.any(beyond[~on_circle] > 0.0):
        return Stability.UNSTABLE
    if not on_circle.any():
        return Stability.STABLE
    is_one = np.abs(values - 1.0) <= np.sqrt(doubts)
    return Stability.NEUTRAL if np.any(on_circle & is_one) else Stability.UNDAMPED


def describe_samples(compiled: CompiledMechanism) -> tuple[Diagnostic, ...]:
    """Return a note on what a steady state of sampled blocks is; empty: there are none."""
    blocks = compiled.mechanism.sampled
    if not blocks:
        return ()
    text = (
        f"sampled blocks, such as {blocks[0].name!r}, have outputs that the next samples do not change; the stability "
        "is that of the motion with samples"
    )
    if sample_times(np.array([block.period for block in blocks])) is None:
        text += ", which is not determined: their periods have no common multiple that is short enough"
    return (Diagnostic.note("steady-state", text),)


def explain_no_modes(name: str) -> EquilibriumError:
    """Return the error of requests for a linear model in continuous time of a model ``name`` with sampled blocks."""
    return EquilibriumError(
        f"model {name!r} has sampled blocks, about whose steady state no linear model in continuous time describes the "
        "motion; allowed: its stability and its multipliers (Equilibrium.multipliers). Use continuous blocks for modes "
        "and state matrices"
    )
