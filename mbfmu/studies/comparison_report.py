"""A comparison as text: its table, and the reference."""

from __future__ import annotations

from collections.abc import Iterable

from mbfmu.studies.compare import Comparison, Row, describe_outcome
from mbfmu.studies.reference import Reference
from mbfmu.studies.resolution import resolution_text
from mbfmu.util.diagnostics import render
from mbfmu.util.text_table import format_table, format_tolerance

MAX_LISTED_OUTPUTS = 6  # names in a list, before the rest is counted


def as_text(found: Comparison) -> str:
    """Return the rows as a text table, with the reference and the omissions below it."""
    resolved = any(row.resolution for row in found.rows)
    split = any(row.space_error is not None for row in found.rows)
    best = found.best()
    lines = [
        (
            "*" if row in best else "",
            row.solver,
            format_tolerance(row.rtol),
            *([resolution_text(row.resolution)] if resolved else []),
            f"{1e3 * row.cpu_s:.3g}",
            f"{100.0 * row.spread:.0f} %" if row.runs > 1 else "-",
            "-" if row.steps is None else str(row.steps),
            str(row.rhs_evals),
            _number(row.error),
            *([_number(row.time_error), _number(row.space_error)] if split else []),
            row.worst or "-",
            _number(row.energy_error),
            str(row.partition_switches),
            describe_outcome(row),
        )
        for row in found.rows
    ]
    header = (
        *("best", "solver", "rtol"),
        *(["resolution"] if resolved else []),
        *("CPU [ms]", "spread", "steps", "evals", "error"),
        *(["in time", "in space"] if split else []),
        *("worst output", "energy error [J]", "switches", "outcome"),
    )
    return "\n".join([format_table(header, lines), "", *explain_table(found)])


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1e}"


def explain_table(found: Comparison) -> list[str]:
    """Return the explanations below the table."""
    reference_data = found.reference
    runs = {row.runs for row in found.rows}
    most = f"{min(runs)} to {max(runs)}" if len(runs) > 1 else f"{max(runs)}"
    lines = [
        "error: largest error of an output over the run, relative to the range of the output (energies: relative to "
        "the energy exchanged, if that is larger)",
        f"CPU time: median of {most} interleaved runs; spread: interquartile range relative to the median",
        f"compared outputs: {listed(reference_data.units)}",
        describe_reference(reference_data),
    ]
    reasons: dict[str, list[str]] = {}
    for name, why in reference_data.not_evaluated.items():
        reasons.setdefault(why, []).append(name)
    lines += [f"excluded outputs: {listed(names)} ({why})" for why, names in reasons.items()]
    if doubtful := [row for row in found.rows if row.error is not None and row.error < reference_data.doubt[0]]:
        lines.append(f"runs with an error below the uncertainty of the reference: {len(doubtful)} of {len(found.rows)}")
    return [*lines, *render(found.diagnostics)]


def describe_reference(reference_data: Reference) -> str:
    """Return the reference and its uncertainty."""
    doubt, name = reference_data.doubt
    text = f"reference: {reference_data.motion.source}; uncertainty {doubt:.0e} of the range ({name})"
    if orders := sorted(reference_data.orders[name] for name in reference_data.units if name in reference_data.orders):
        extrapolated = f"{orders[0]:.1f} to {orders[-1]:.1f} in {len(orders)} of {len(reference_data.units)} outputs"
        text += f"; extrapolated with the observed orders of convergence, {extrapolated}"
    elif len(reference_data.tight) > 1:
        text += "; no order of convergence observed, so the error in space is relative to the finest discretisation"
    tight = dict.fromkeys(motion.source for motion in reference_data.tight if motion is not None)
    return (
        f"{text}; error in time relative to {', '.join(tight)}" if reference_data.motion.source not in tight else text
    )


def listed(names: Iterable[str]) -> str:
    """Return names in a list, of many the first ones."""
    found = list(names)
    more = len(found) - MAX_LISTED_OUTPUTS
    return ", ".join(found[:MAX_LISTED_OUTPUTS]) + (f" and {more} more" if more > 0 else "")


def label(row: Row) -> str:
    """Return tolerance and resolution of a row, for its point in a picture."""
    return f"{format_tolerance(row.rtol)} {resolution_text(row.resolution)}".strip()
