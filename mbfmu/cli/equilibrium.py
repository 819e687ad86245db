"""``mbfmu equilibrium``."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Mapping, Sequence

import numpy as np

from mbfmu.modeling.scene import Scene
from mbfmu.plotting.steady_states import plot_branches
from mbfmu.steady.equilibrium import build_problem, equilibrium
from mbfmu.steady.state import Equilibrium
from mbfmu.steady.supports import FOLLOWED_TEXT
from mbfmu.steady.sweep import Branch, sweep
from mbfmu.util.errors import UserError, suggest
from mbfmu.util.files import replacing
from mbfmu.util.text_table import format_table

from .common import (
    Commands,
    add_json,
    add_output,
    add_steady,
    assignments,
    bar,
    number,
    print_if_verbose,
    print_inputs,
    print_paths,
    print_unless_quiet,
    reader,
    scene_of,
    scene_part,
    start_of,
    write_json,
)
from .completion import complete, output_names
from .results import Results, results


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu equilibrium``."""
    p = commands.add_parser(
        "equilibrium",
        help=about,
        description="""Find the steady state of a model at constant drive speeds (at rest if there are no drives), its
stability, the natural modes about it, and other steady states. The results are printed; --json writes them to a file.

With --sweep the steady states are followed over a parameter. Each branch is a line of the printed table. The results
are in a folder such as results/governor/default-sweep-spindle_speed:
  branches.png   an output over the parameter
  branches.csv   all states: parameter, outputs and stability
  branches.json  all states with all details""",
        epilog="examples:\n  mbfmu equilibrium governor\n  mbfmu equilibrium governor --from arm1=0.8 --from arm2=0.8\n"
        "  mbfmu equilibrium governor --sweep spindle_speed=5:20:0.25 --plot collar.height\n",
    )
    add_steady(p)
    p.add_argument(
        "--others",
        type=reader(int),
        metavar="N",
        help="number of further start points for the search of other states (default 24; 4 for large models)",
    )
    p.add_argument(
        "--sweep", metavar="PARAMETER=FROM:TO:STEP", help="parameter over which the steady states are followed"
    )
    shown = p.add_argument(
        "--plot", metavar="OUTPUT", help="output to plot over the parameter (default: the first of the model)"
    )
    complete(shown, output_names)
    add_json(p)
    add_output(p, "MODEL/SCENE-sweep-PARAMETER")
    p.set_defaults(command=command_equilibrium)


def command_equilibrium(options: argparse.Namespace) -> int:
    """Find a steady state, or a family of them."""
    scene = scene_of(options)
    if options.others is not None and options.others < 0:
        raise UserError(f"--others is {options.others}; allowed: 0 or more")
    if options.sweep:
        return swept(scene, options)
    found = equilibrium(scene.model, start_of(options))
    others = [] if found.found_from == FOLLOWED_TEXT else build_problem(scene.model).others(found, options.others)
    if options.json:
        write_json({**found.as_dict(), "others": [other.as_dict() for other in others]}, options.json)
    if not options.json or str(options.json) != "-":
        print_inputs(options, scene)
        print(as_text(found, others))
        print_if_verbose(options, f"{1 + len(others)} steady states; the first took {found.effort}")
    return 0


def as_text(found: Equilibrium, others: Sequence[Equilibrium]) -> str:
    """Return a steady state as text, and a table of the others."""
    if not others:
        return str(found)
    rows = [[f"{x:.9g}" for x in other.positions().values()] + [other.stability] for other in others]
    return "\n".join((str(found), "", "other steady states:", format_table([*found.positions(), "stability"], rows)))


def swept(scene: Scene, options: argparse.Namespace) -> int:
    """Follow the steady states over a parameter; print a line a branch, write every state."""
    parameter, values = read_sweep(options.sweep)
    model = scene.model
    outputs = {variable.name: variable.unit for variable in model.compile().outputs}
    shown = options.plot or next(iter(outputs))
    if shown not in outputs:
        raise UserError(f"--plot: there is no output {shown!r}{suggest(shown, outputs)}")
    model.with_values({parameter: values[0]})  # complains of the parameter
    unit = next(p.unit for p in model.parameters() if p.name == parameter)
    axes = f"{parameter} [{unit}]", f"{shown} [{outputs[shown]}]"
    with results(options.output, scene, f"{scene_part(scene)}-sweep-{parameter}") as place:
        with bar(len(values), "sweep", options.quiet) as seen:
            branches = sweep(model, parameter, values, progress=lambda _: seen.update())
        plot_branches(branches, axes[0], shown, f"{scene.name}: steady states", place.file("branches.png"))
        content = {"parameter": parameter, "branches": [as_list(branch) for branch in branches]}
        write_json(content, place.file("branches.json"))
        write_states(place, branches, axes[0], outputs)
        if options.json:
            write_json(content, options.json)
        kept = place.keep()
    if str(options.json) != "-":
        print_inputs(options, scene)
        print_unless_quiet(options, branches_as_text(branches, *axes, shown))
        print_paths(options, kept)
    return 0


def write_states(place: Results, branches: Sequence[Branch], axis: str, outputs: Mapping[str, str]) -> None:
    """Write every state of every branch as CSV."""
    with (
        replacing(place.file("branches.csv")) as unfinished,
        unfinished.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(["branch", axis, *(f"{name} [{unit}]" for name, unit in outputs.items()), "stability"])
        for k, branch in enumerate(branches, 1):
            for value, state in zip(branch.values, branch.states, strict=True):
                writer.writerow([k, repr(value), *(repr(state.outputs[name]) for name in outputs), state.stability])


def branches_as_text(branches: Sequence[Branch], parameter: str, output: str, shown: str) -> str:
    """Return a line for every branch: from where to where it goes, and where its stability changes."""
    rows = []
    for k, branch in enumerate(branches, 1):
        heights = [state.outputs[shown] for state in branch.states]
        rows.append((str(k), str(len(heights)), span(branch.values), span(heights), stability_of(branch)))
    return format_table(("branch", "states", parameter, output, "stability"), rows)


def span(values: Sequence[float]) -> str:
    """Return the first and the last of several values."""
    first, last = f"{values[0]:.6g}", f"{values[-1]:.6g}"
    return first if first == last else f"{first} to {last}"


def stability_of(branch: Branch) -> str:
    """Return the stability along a branch, and the values of the parameter from which on it is another."""
    told: list[str] = [branch.states[0].stability]
    for value, before, state in zip(branch.values[1:], branch.states, branch.states[1:], strict=False):
        if state.stability != before.stability:
            told.append(f"{state.stability} from {value:g}")
    return ", ".join(told)


def as_list(branch: Branch) -> list[dict[str, object]]:
    """Return a branch for JSON."""
    return [{"value": v, **state.as_dict()} for v, state in zip(branch.values, branch.states, strict=True)]


def read_sweep(text: str) -> tuple[str, list[float]]:
    """Read ``PARAMETER=FROM:TO:STEP``; the end is included."""
    ((name, span),) = assignments("--sweep", [text]).items()
    parts = [number("--sweep", part) for part in span.split(":")]
    if len(parts) != 3 or not np.isfinite(parts).all() or parts[2] == 0.0 or (parts[1] - parts[0]) / parts[2] < 0.0:
        raise UserError(f"--sweep is {text!r}; allowed: PARAMETER=FROM:TO:STEP with a step from FROM towards TO")
    begin, end, step = parts
    count = int((end - begin) / step + 1e-9) + 1
    if count > 10_000:
        raise UserError(f"--sweep is {text!r}, which has {count} values; allowed: at most 10000")
    return name, [begin + step * k for k in range(count)]
