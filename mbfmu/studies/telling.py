"""Report of :func:`mbfmu.studies.check.check` as text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite, isinf, pi
from typing import TYPE_CHECKING

from mbfmu.energy_check import NEAR
from mbfmu.table import counted, power
from solvers.inertia import LARGE_GROWTH

if TYPE_CHECKING:
    from mbfmu.studies.check import Findings, Stiffness
    from mbfmu.studies.loops import Loop
    from mbfmu.studies.nearest import Nearest
    from solvers import Statistics

TOLD = 6  # loops that are reported one by one
MANY = 3  # outputs to a step from which on they cost more than it


def reasons(found: Findings) -> tuple[str, ...]:
    """Return what makes a scene hard, in a few words each."""
    near, stiff = found.nearest, found.suits is not None and found.suits.stiff
    known = {
        "it does not start": found.freedom is None,
        "it stops early": found.failure and found.freedom is not None,
        "its motion is not to be trusted": found.warning,
        "it passes a singular position": near and near.ratio <= NEAR and near.gap == 0.0,
        "it comes near a singular position": near and near.ratio <= NEAR and near.gap != 0.0,
        "its mass matrix is nearly singular at times": found.statistics and found.statistics.rate_growth > LARGE_GROWTH,
        "it is stiff": stiff,
        "stability sets its steps": found.limit == "stability" and stiff,
        "its steps are refused beside singular positions": found.limit == "singular positions",
        "rows of its loops are redundant, and forces in them not determined": found.redundant,
    }
    return tuple(text for text, true in known.items() if true)


def in_words(found: Findings) -> str:
    """Return the findings in sentences, one a line."""
    why = "; ".join(found.hard)
    head = f"{found.name}: {f'hard: {why}' if why else 'nothing about it is hard'}"
    return "\n".join([head, *(f"  {line}" for line in lines(found))])


def lines(found: Findings) -> Iterator[str]:
    """Yield the sentences."""
    how = "a tree, by its recursions" if found.tree else "by its matrices"
    if found.coordinates:
        free = "" if found.freedom is None else f", {found.freedom} free"
        rows = counted(found.rows, "row")
        yield f"size: {counted(found.coordinates, 'coordinate')} under {rows} of loops{free}; {how}"
    if found.failure:
        yield f"{'no start' if found.freedom is None else f'stopped at {found.reached:.6g} s'}: {found.failure}"
    if found.warning:
        yield f"not to be trusted: {found.warning}"
    if found.nearest:
        yield f"singular positions: {of_nearest(found.nearest)}"
    if (found.rows or found.vanishing) and found.freedom is not None:
        yield f"redundant rows: {of_rows(found)}"
    if found.statistics and found.statistics.rate_growth > LARGE_GROWTH:
        yield f"mass matrix: {describe_growth(found.statistics)}"
    if found.stiffness:
        yield f"stiffness: {of_stiffness(found.stiffness)}"
    if found.statistics and found.statistics.steps:
        yield f"steps: {of_steps(found, found.statistics)}"
    yield from (f"loop {of_loop(loop)}" for loop in found.loops[:TOLD])
    if len(found.loops) > TOLD:
        yield f"and {len(found.loops) - TOLD} more loops"
    if found.suits:
        yield f"solver: take {found.suits.solver!r}; {found.suits.reason}"
    yield from (f"not looked at: {text}" for text in found.unseen)


def of_nearest(near: Nearest) -> str:
    """Report the nearest singular configuration."""
    names = some(near.loops)
    where = f"singular values of {near.ratio:.1e} at t = {near.t:.9g} s, in the loop of {names}"
    if near.ratio > NEAR:
        return f"none is near; the least are {where}"
    if near.gap == 0.0:
        what = "passed exactly: branches of the motion cross there"
    elif isinf(near.gap):
        what = "passed beside: motions of several freedoms go round it"
    elif isfinite(near.gap):
        what = f"missed by {near.gap:.1e} of the loop's size: branches part there"
    else:
        what = "near, and not known whether it is passed or missed"
    often = f"; near {near.passes} times" if near.passes > 1 else ""
    return f"{what}; {where}{often}"


def describe_growth(s: Statistics) -> str:
    """Describe where the mass matrix is nearly singular."""
    return (
        f"nearly singular at t = {s.rate_growth_at:.9g} s, as where a light body carries a heavy one; errors of rates "
        f"grow {s.rate_growth:.2g} times there, and the solver uses a finer tolerance"
    )


def of_rows(found: Findings) -> str:
    """Report redundant constraint equations."""
    if not found.rows:
        return f"{len(found.vanishing)} of {len(found.vanishing)}; the joints alone keep them, and they are dropped"
    which = f" ({some(found.redundant)})" if found.redundant else ""
    parts = [f"{len(found.redundant)} of {found.rows}{which}"]
    if found.vanishing:
        parts.append(f"{len(found.vanishing)} more, which the joints alone keep, are dropped")
    return "; ".join(parts)


def of_stiffness(s: Stiffness) -> str:
    """Report the fastest motion relative to the motion that is resolved."""
    value = s.eigenvalue
    imaginary = f" ± {abs(value.imag):.4g}i" if value.imag else ""
    times = f"{s.ratio:.3g} times as fast as" if s.ratio > 1.0 else "no faster than"
    from_states = f"from {counted(s.states, 'state')}"
    if not value:
        return f"every eigenvalue is zero, and the motion's own rate is {s.own:.3g} 1/s; {from_states}"
    swing = f" ({abs(value.imag) / (2.0 * pi):.3g} Hz)" if value.imag else ""
    return (
        f"the fastest motion has the eigenvalue {value.real:.4g}{imaginary} 1/s{swing}, mostly in {s.coordinate!r} "
        f"(t = {s.t:.4g} s), {times} what moves by more than {power(s.tolerance)} ({s.followed:.3g} 1/s, the motion's "
        f"own rate being {s.own:.3g} 1/s); {from_states}"
    )


def of_steps(found: Findings, s: Statistics) -> str:
    """Report what limits the step size."""
    why = {
        "accuracy": "accuracy sets their length",
        "stability": f"stability sets the length of {s.stability_limited}, not accuracy: no tolerance makes fewer",
        "singular positions": f"singular positions do: {s.refused} were refused",
        "max_step": "max_step sets their length",
        "drives": "what drives or loads it over time sets their length, so that none of it is missed",
    }[found.limit]
    run = f"{s.steps} of {found.solver!r} at {power(found.tolerance)} in {found.reached:.4g} s, {s.rejected} rejected"
    parts = [run, why]
    if s.coarser > 1.0:
        parts.append(
            f"beside a near miss the tolerance was {s.coarser * found.tolerance:.0e}: rounding allows no finer"
        )
    if found.outputs > MANY * s.steps:
        parts.append(
            f"{found.outputs} outputs take longer than they do: a longer output interval saves most of the time"
        )
    return "; ".join(parts)


def some(names: Sequence[str]) -> str:
    """Return names, the first few where there are many."""
    told = [repr(name) for name in names[:TOLD]]
    if len(names) > TOLD:
        told.append(f"{len(names) - TOLD} more")
    return " and ".join(filter(None, (", ".join(told[:-1]), told[-1])))


def of_loop(loop: Loop) -> str:
    """Report a loop."""
    path = " - ".join(loop.bodies) if len(loop.bodies) <= 2 * TOLD else f"{len(loop.bodies)} bodies"
    size = f"{loop.size:.4g} m"
    closed = f", closed to {loop.gap:.1e} of it" if isfinite(loop.gap) else ""
    return f"{loop.name!r}: {path}; size {size}{closed}"
