"""``mbfmu equilibrium``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from mbfmu.errors import UserError
from mbfmu.model import Model, suggest
from mbfmu.steady.linear import modes_as_text
from mbfmu.steady.problem import EquilibriumProblem
from mbfmu.steady.state import Equilibrium
from mbfmu.steady.sweep import Branch, sweep
from mbfmu.studies.report import plot_branches
from mbfmu.table import table

from .common import Commands, add_output, add_steady, assignments, folder, number, scene_of, start_of, write_json

WORDS = {
    "stable": "stable: every mode decays",
    "undamped": "stable, undamped: some modes oscillate for ever",
    "neutral": "neutral: some modes drift",
    "unstable": "UNSTABLE: some modes grow",
}


def add(commands: Commands) -> None:
    """Describe ``mbfmu equilibrium``."""
    p = commands.add_parser(
        "equilibrium",
        help="steady state at constant drive speed, or at rest, with its stability",
        description="Find where a model stays while its drives turn at constant speed (static equilibrium without "
        "drives), how it moves about that state, and which other steady states there are.",
    )
    add_steady(p)
    p.add_argument(
        "--others", type=int, metavar="N", help="scattered starts to look for other states (24; 4 on large trees)"
    )
    p.add_argument("--sweep", metavar="PARAMETER=FROM:TO:STEP", help="follow the steady states over a parameter; plots")
    p.add_argument("--plot", metavar="OUTPUT", help="output to plot over the sweep (the model's first)")
    p.add_argument(
        "--json",
        type=Path,
        nargs="?",
        const=Path("-"),
        metavar="FILE",
        help="write JSON, to standard output by default",
    )
    add_output(p, "the sweep's plot")
    p.set_defaults(command=command_equilibrium)


def command_equilibrium(options: argparse.Namespace) -> int:
    """Find a steady state, or a family of them."""
    scene = scene_of(options)
    if options.others is not None and options.others < 0:
        raise UserError(f"--others is {options.others}; allowed: 0 or more")
    if options.sweep:
        return swept(scene.model, scene.name, options)
    problem = EquilibriumProblem(scene.model)
    start = start_of(options)
    found = problem.solve(problem.start(start), "the start given") if start else problem.solve()
    others = problem.others(found, options.others)
    if options.json:
        write_json({**found.as_dict(), "others": [other.as_dict() for other in others]}, options.json)
    if not options.json or str(options.json) != "-":
        print(as_text(found, others))
    return 0


def as_text(found: Equilibrium, others: Sequence[Equilibrium]) -> str:
    """Describe a steady state to people."""
    units = {v.name: v.unit for v in found.plant.outputs}
    values = table(("output", "value", "unit"), [(k, f"{x:.12g}", units[k]) for k, x in found.outputs.items()])
    lines = [
        f"{found.model.name}: steady state found from {found.found_from} in {found.iterations} Newton iterations "
        f"({1e3 * found.solve_time:.2f} ms), residual {found.residual:.1e} N or N m",
        *(f"note: {note}" for note in found.notes),
        values,
        "",
        WORDS[found.stability] + (f"; nothing resists {found.free}" if found.free else ""),
        modes_as_text(found.modes),
    ]
    if found.warning:
        lines += ["", f"warning: {found.warning}"]
    if others:
        names = list(found.positions())
        rows = [[f"{x:.9g}" for x in other.positions().values()] + [other.stability] for other in others]
        lines += ["", "other steady states:", table([*names, "stability"], rows)]
    return "\n".join(lines)


def swept(model: Model, name: str, options: argparse.Namespace) -> int:
    """Follow the steady states over a parameter; print a table, draw the branches."""
    parameter, values = read_sweep(options.sweep)
    outputs = [variable.name for variable in model.plant().outputs]
    shown = options.plot or outputs[0]
    if shown not in outputs:
        raise UserError(f"--plot {shown!r}: no such output{suggest(shown, outputs)}")
    with tqdm(total=len(values), desc="sweep", leave=False, disable=not sys.stderr.isatty()) as bar:
        branches = sweep(model, parameter, values, progress=lambda _: bar.update())
    picture = folder(options.output) / f"{name}_{parameter}.png"
    unit = next(p.unit for p in model.parameters() if p.name == parameter)
    plot_branches(branches, f"{parameter} [{unit}]", shown, f"{name}: steady states", picture)
    if options.json:
        write_json({"parameter": parameter, "branches": [as_list(branch) for branch in branches]}, options.json)
    if not options.json or str(options.json) != "-":
        rows = [
            (str(k + 1), f"{value:g}", f"{state.outputs[shown]:.9g}", state.stability)
            for k, branch in enumerate(branches)
            for value, state in zip(branch.values, branch.states, strict=True)
        ]
        print(table(("branch", parameter, shown, "stability"), rows))
        print(f"wrote {picture}")
    return 0


def as_list(branch: Branch) -> list[dict[str, object]]:
    """Return a branch for JSON."""
    return [{"value": v, **state.as_dict()} for v, state in zip(branch.values, branch.states, strict=True)]


def read_sweep(text: str) -> tuple[str, list[float]]:
    """Read ``PARAMETER=FROM:TO:STEP``; the end is included."""
    ((name, span),) = assignments("--sweep", [text]).items()
    parts = [number("--sweep", part) for part in span.split(":")]
    if len(parts) != 3 or not np.isfinite(parts).all() or parts[2] == 0.0 or (parts[1] - parts[0]) / parts[2] < 0.0:
        raise UserError(f"--sweep {text!r}: write PARAMETER=FROM:TO:STEP with a step that leads from FROM to TO")
    begin, end, step = parts
    count = int((end - begin) / step + 1e-9) + 1
    if count > 10_000:
        raise UserError(f"--sweep {text!r} asks for {count} values; allowed: at most 10000")
    return name, [begin + step * k for k in range(count)]
