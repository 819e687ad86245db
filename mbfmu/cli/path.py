"""``mbfmu path``."""

from __future__ import annotations

import argparse

from mbfmu.plotting.steady_states import plot_path
from mbfmu.steady.path import MAX_BRANCH_STATES, EquilibriumPath, equilibrium_path
from mbfmu.util.errors import UserError, suggest
from mbfmu.util.text_table import format_table

from .common import (
    Commands,
    add_json,
    add_output,
    add_steady,
    assignments,
    bar,
    number,
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
from .results import results


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu path``."""
    p = commands.add_parser(
        "path",
        help=about,
        description="""Follow the steady states of a model while one of its inputs changes: a force, gravity, the
position of a support, the speed of a drive. The path is followed by pseudo-arc-length continuation, which passes
limit points and includes unstable states. Limit points and bifurcations are printed; --second also follows the paths
that cross at bifurcations, such as that of a buckled column. The results are in a folder such as
results/sheet/default-path-force.y:
  path.png   the input against an output; unstable parts dashed, limit points and bifurcations marked
  path.csv   all states: input, outputs, stability, and number of unstable motions
Use `mbfmu equilibrium --sweep` for parameters, which require a new model for each value.""",
        epilog="examples:\n"
        "  mbfmu path sheet --set stretch=true --set load=tip --over force.y=0:-2\n"
        "  mbfmu path governor --over spindle.drive=5:20 --plot collar.height\n"
        "  mbfmu path my_model.py:Truss --over force=0:-500 --until apex.y=-0.2 --second\n",
    )
    add_steady(p)
    p.add_argument("--over", required=True, metavar="INPUT=FROM:TO", help="input that changes, and its range")
    p.add_argument("--until", metavar="OUTPUT=VALUE", help="end the path earlier, where an output has this value")
    p.add_argument(
        "--second", action="store_true", help="also follow, in both directions, the paths that cross at bifurcations"
    )
    p.add_argument(
        "--steps",
        type=reader(int),
        default=MAX_BRANCH_STATES,
        metavar="N",
        help=f"maximum number of steps of a branch (default {MAX_BRANCH_STATES})",
    )
    shown = p.add_argument(
        "--plot", metavar="OUTPUT", help="output to plot (default: that of --until, or the first of the model)"
    )
    complete(shown, output_names)
    add_json(p)
    add_output(p, "MODEL/SCENE-path-INPUT")
    p.set_defaults(command=command_path)


def command_path(options: argparse.Namespace) -> int:
    """Follow a path."""
    scene = scene_of(options)
    over, ends = read_range(options.over)
    until = None
    if options.until:
        ((name, value),) = assignments("--until", [options.until]).items()
        until = name, number("--until", value)
    outputs = [variable.name for variable in scene.model.compile().outputs]
    shown = options.plot or (until[0] if until else outputs[0])
    if shown not in outputs:
        raise UserError(f"{'--plot' if options.plot else '--until'} {shown!r}: no such output{suggest(shown, outputs)}")
    with results(options.output, scene, f"{scene_part(scene)}-path-{over}") as place:
        with bar(options.steps, "path", options.quiet) as seen:
            found = equilibrium_path(
                scene.model, over, ends, until=until, second=options.second, start=start_of(options),
                steps=options.steps, progress=lambda _: seen.update(),
            )  # fmt: skip
        plot_path(found, shown, f"{scene.name}: equilibrium path", place.file("path.png"))
        found.write_csv(place.file("path.csv"))
        if options.json:
            write_json(found.as_dict(), options.json)
        kept = place.keep()
    if str(options.json) != "-":
        print_inputs(options, scene)
        print_unless_quiet(options, as_text(found, shown))
        print_paths(options, kept)
    return 0


def as_text(found: EquilibriumPath, shown: str) -> str:
    """Return the ends and the singular points of every branch, and why it ended early."""
    rows, notes = [], []
    for k, branch in enumerate(found.branches, 1):
        for state in branch.states:
            ends = {id(branch.states[0]): "begins", id(branch.states[-1]): "ends"}
            if what := state.kind or ends.get(id(state), ""):
                values = f"{state.value:.9g}", f"{state.outputs[shown]:.9g}"
                rows.append((str(k), what, *values, state.stability, str(state.unstable)))
        if branch.ended:
            notes.append(f"branch {k} ended early: {branch.ended}")
    axes = f"{found.input} [{found.unit}]", f"{shown} [{found.units[shown]}]"
    return "\n".join([format_table(("branch", "", *axes, "stability", "unstable motions"), rows), *notes])


def read_range(text: str) -> tuple[str, tuple[float, float]]:
    """Read ``INPUT=FROM:TO``."""
    ((name, span),) = assignments("--over", [text]).items()
    parts = span.split(":")
    if len(parts) != 2:
        raise UserError(f"--over is {text!r}; allowed: INPUT=FROM:TO, as in --over force.y=0:-3000")
    begin, end = (number("--over", part) for part in parts)
    return name, (begin, end)
