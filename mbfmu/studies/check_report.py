"""Report of :func:`mbfmu.studies.check.check` as text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite, isinf, pi
from typing import TYPE_CHECKING

from mbfmu.session.energy_check import NEAR_SINGULAR_RATIO
from mbfmu.util.diagnostics import render
from mbfmu.util.text_table import format_count, format_tolerance
from solvers.inertia import LARGE_GROWTH

if TYPE_CHECKING:
    from mbfmu.studies.check import Findings, Stiffness
    from mbfmu.studies.loops import Loop
    from mbfmu.studies.nearest_singularity import Nearest
    from solvers import Statistics

MAX_LISTED_NAMES = 6  # loops that are reported one by one
MIN_STIFF_RATE_RATIO = 10.0  # fastest eigenvalue, in units of the rate of the resolved motion, of what is stiff
LOCKED_CODES = {"locked-mechanism", "locked-loop"}
OUTPUTS_PER_STEP_LIMIT = 3  # outputs to a step from which on they cost more than it


def reasons(found: Findings) -> tuple[str, ...]:
    """Return what makes a scene numerically difficult."""
    near, stiff = found.nearest, is_stiff(found)
    known = {
        "it does not start": found.freedom is None,
        "it stops early": found.failed and found.freedom is not None,
        "its motion may be wrong": found.warning or any(d.code in LOCKED_CODES for d in found.diagnostics),
        "it passes through a singular configuration": near and near.ratio <= NEAR_SINGULAR_RATIO and near.gap == 0.0,
        "it comes near a singular configuration": near and near.ratio <= NEAR_SINGULAR_RATIO and near.gap != 0.0,
        "its mass matrix is nearly singular at times": found.statistics and found.statistics.rate_growth > LARGE_GROWTH,
        "it is stiff": stiff,
        "its step size is limited by stability": found.limit == "stability" and stiff,
        "its steps are rejected near singular configurations": found.limit == "singular configurations",
        "its constraints are redundant, and their reaction forces not unique": found.redundant,
    }
    return tuple(text for text, true in known.items() if true)


def is_stiff(found: Findings) -> bool:
    """Whether stability limits explicit steps, because something is much faster than the motion that is resolved.

    An implicit solver may also be recommended for a motion that dies out, at which nothing is faster than the motion.
    """
    if found.suits is None or not found.suits.stiff:
        return False
    return found.stiffness is None or found.stiffness.ratio >= MIN_STIFF_RATE_RATIO  # None: eigenvalues are not known


def format_findings(found: Findings) -> str:
    """Return the findings as text, one per line."""
    why = "; ".join(found.hard)
    head = f"{found.name}: {f'numerically difficult: {why}' if why else 'no numerical difficulties'}"
    return "\n".join([head, *(f"  {line}" for line in lines(found))])


def lines(found: Findings) -> Iterator[str]:
    """Yield the lines."""
    how = "large model, recursive solver" if found.tree else "dense matrices"
    if found.coordinates or found.states:
        free = "" if found.freedom is None else f", {describe_freedom(found)}"
        rows = format_count(found.rows, "constraint")
        states = f", {format_count(found.states, 'first-order state')}" if found.states else ""
        yield f"size: {format_count(found.coordinates, 'joint coordinate')}{states}, {rows}{free}; {how}"
    if found.failed:
        yield f"{'does not start' if found.freedom is None else f'stopped at {found.reached:.6g} s'}: {found.failure}"
    yield from render(d for d in found.diagnostics if d.severity == "warning")
    if found.nearest:
        yield f"singular configurations: {describe_nearest(found.nearest)}"
    if (found.rows or found.vanishing) and found.freedom is not None:
        yield f"redundant constraints: {describe_redundant(found)}"
    if found.statistics and found.statistics.rate_growth > LARGE_GROWTH:
        yield f"mass matrix: {describe_growth(found.statistics)}"
    if found.stiffness:
        yield f"stiffness: {describe_stiffness(found.stiffness)}"
    if found.statistics and found.statistics.steps:
        yield f"steps: {describe_step_limit(found, found.statistics)}"
    yield from (f"loop {describe_loop(loop)}" for loop in found.loops[:MAX_LISTED_NAMES])
    if len(found.loops) > MAX_LISTED_NAMES:
        yield f"and {len(found.loops) - MAX_LISTED_NAMES} more loops"
    if found.suits:
        yield f"recommended solver: {found.suits.solver!r}; {found.suits.reason}"
    reported = ("redundant-constraints", "selected-solver")  # above
    yield from render(d for d in found.diagnostics if d.severity == "note" and d.code not in reported)


def describe_freedom(found: Findings) -> str:
    """Report the number of degrees of freedom, of positions apart if constraints are nonholonomic."""
    text = f"{degrees(found.freedom or 0)} of freedom"
    if found.position_freedom in (found.freedom, None):
        return text
    return f"{text} ({found.position_freedom} of positions: some constraints are nonholonomic)"


def degrees(count: int) -> str:
    """Return a number of degrees."""
    return f"{count} degree{'s' * (count != 1)}"


def describe_nearest(near: Nearest) -> str:
    """Report the nearest singular configuration."""
    names = list_first(near.loops)
    where = (
        f"smallest singular value of the constraint Jacobian {near.ratio:.1e} (relative to the largest) at "
        f"t = {near.t:.6g} s, loop {names}"
    )
    if near.ratio > NEAR_SINGULAR_RATIO:
        return f"none; {where}"
    often = f" {near.passes} times" if near.passes > 1 else ""
    if near.gap == 0.0:
        what = f"passed{often} (branches of the motion cross)"
    elif isinf(near.gap):
        what = f"avoided{often} by a motion with several degrees of freedom"
    elif isfinite(near.gap):
        what = f"missed{often} by {near.gap:.1e} of the size of the loop"
    else:
        what = f"near{often}; not known whether it is passed or missed"
    return f"{what}; {where}"


def describe_growth(statistics: Statistics) -> str:
    """Describe when the mass matrix is nearly singular."""
    return (
        f"nearly singular at t = {statistics.rate_growth_at:.6g} s, as if a light body carries a heavy one; errors of "
        "velocities "
        f"are amplified by a factor of {statistics.rate_growth:.2g}, and the solver uses a smaller tolerance"
    )


def describe_redundant(found: Findings) -> str:
    """Report redundant constraint equations."""
    if not found.rows:
        return f"none ({format_count(len(found.vanishing), 'constraint')} always satisfied and removed)"
    which = f" ({list_first(found.redundant)})" if found.redundant else ""
    more = f"; {len(found.vanishing)} further always satisfied and removed" if found.vanishing else ""
    return f"{len(found.redundant) or 'none'} of {found.rows}{which}{more}"


def describe_stiffness(stiffness: Stiffness) -> str:
    """Report the fastest motion relative to the motion that is resolved."""
    value = stiffness.eigenvalue
    imaginary = f" ± {abs(value.imag):.4g}i" if value.imag else ""
    examined = f"{format_count(stiffness.states, 'state')} examined"
    if not value:
        return f"none: all eigenvalues are zero; the motion changes at {stiffness.own:.3g} 1/s ({examined})"
    swing = f", {abs(value.imag) / (2.0 * pi):.3g} Hz" if value.imag else ""
    ratio = f"ratio {stiffness.ratio:.3g}" if stiffness.ratio >= MIN_STIFF_RATE_RATIO else "none"
    return (
        f"{ratio}; largest eigenvalue {value.real:.4g}{imaginary} 1/s (mainly {stiffness.coordinate!r}{swing}, "
        f"t = {stiffness.t:.4g} s), the motion with amplitudes above {format_tolerance(stiffness.tolerance)} changes "
        f"at {stiffness.followed:.3g} 1/s "
        f"({examined})"
    )


def describe_step_limit(found: Findings, statistics: Statistics) -> str:
    """Report what limits the step size."""
    why = {
        "accuracy": "step size limited by accuracy",
        "stability": f"step size of {statistics.stability_limited} limited by stability, which no tolerance changes",
        "singular configurations": f"step size limited by singular configurations, {statistics.refused} rejected there",
        "max_step": "step size limited by max_step",
        "drives": "step size limited by time-dependent drives and loads, so that no change is missed",
    }[found.limit]
    run = (
        f"{statistics.steps} ({statistics.rejected} rejected) with {found.solver!r} at tolerance "
        f"{format_tolerance(found.tolerance)} until "
        f"t = {found.reached:.4g} s"
    )
    parts = [run, why]
    if statistics.coarser > 1.0:
        parts.append(
            f"tolerance increased to {statistics.coarser * found.tolerance:.0e} near a singular configuration because "
            "of rounding"
        )
    if found.outputs > OUTPUTS_PER_STEP_LIMIT * statistics.steps:
        parts.append(
            f"{found.outputs} outputs take more time than the steps: a longer output interval saves most of it"
        )
    return "; ".join(parts)


def list_first(names: Sequence[str]) -> str:
    """Return the first few of the names."""
    listed = [repr(name) for name in names[:MAX_LISTED_NAMES]]
    if len(names) > MAX_LISTED_NAMES:
        listed.append(f"{len(names) - MAX_LISTED_NAMES} more")
    return " and ".join(filter(None, (", ".join(listed[:-1]), listed[-1])))


def describe_loop(loop: Loop) -> str:
    """Report a loop."""
    path = " - ".join(loop.bodies) if len(loop.bodies) <= 2 * MAX_LISTED_NAMES else f"{len(loop.bodies)} bodies"
    size = f"{loop.size:.4g} m"
    closed = f", largest residual {loop.gap:.1e} of its size" if isfinite(loop.gap) else ""
    return f"{loop.name!r}: {path}; size {size}{closed}"
