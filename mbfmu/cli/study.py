"""``mbfmu study``."""

from __future__ import annotations

import argparse
import shlex
import sys
from itertools import count
from pathlib import Path
from typing import Any

from tqdm import tqdm

from mbfmu.util.errors import UserError

from .common import (
    RESULTS_FOLDER,
    Commands,
    add_input,
    assignments,
    file_name,
    print_if_verbose,
    print_paths,
    print_unless_quiet,
)

STUDY_EXAMPLE = """scene = "fourbar"
count = 200

[vary]
crank_length = "1 m +- 5 mm"
gravity = [1.62, 9.81]

[measure]
fastest = "largest crank.rate"
"""


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu study``."""
    p = commands.add_parser(
        "study",
        help=about,
        description=f"""Simulate a scene or an FMU many times with varied parameters, on all processors of this
machine or on a Dask cluster, and evaluate each run. A TOML file defines the study:

{STUDY_EXAMPLE}
All combinations of lists are run; tolerances and distributions are sampled `count` times. Measures are end, largest,
least, range, mean, rms, crossing and settling of an output, equilibrium, frequency and damping of the steady state, or
"file.py:function". See the page "Studies" of the documentation.

The results are in a folder and are written during the study:
  runs.parquet   one row per run: parameters, measures, status, energy error, CPU time
  study.json     the definition of the study
  *.png          measures over parameters, distributions, sensitivities
A failed run is recorded with its reason and does not end the study. After Ctrl-C, --resume continues.""",
        epilog="examples:\n  mbfmu study tolerances.toml\n  mbfmu study tolerances.toml --resume\n"
        "  mbfmu study tolerances.toml --with native --workers 8\n"
        "  mbfmu study tolerances.toml --scheduler tcp://cluster:8786\n",
    )
    p.add_argument("study", type=Path, help="study file, .toml")
    p.add_argument(
        "--resume", action="store_true", help="continue the study in its folder; finished runs are not repeated"
    )
    p.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="folder of the results (default: results/STUDY-study)"
    )
    p.add_argument(
        "--workers", type=int, default=0, metavar="N", help="number of processes (default: one per processor)"
    )
    p.add_argument(
        "--scheduler", default="", metavar="ADDRESS", help="address of the scheduler of a running Dask cluster"
    )
    p.add_argument("--count", type=int, metavar="N", help="number of samples, instead of that in the file")
    add_input(p)
    p.add_argument("--with", dest="runs", metavar="KIND", help="way to run: simulation, fmu or native")
    p.set_defaults(command=command_study)


def command_study(options: argparse.Namespace) -> int:
    """Make the runs; write what they give, and pictures; print a summary."""
    from mbfmu.ensemble.definition import define, read_study
    from mbfmu.ensemble.pictures import draw
    from mbfmu.ensemble.study import run_study

    content = read_study(options.study)
    content |= {k: v for k, v in (("count", options.count), ("with", options.runs)) if v is not None}
    if given := assignments("--input", options.input):
        content["inputs"] = {**content.get("inputs", {}), **given}
    definition = define(content)
    folder = place(options)
    try:
        with Bar(str(options.study), options.quiet) as bar:
            study = run_study(
                definition, folder, resume=options.resume, scheduler=options.scheduler, workers=options.workers,
                progress=bar.show,
            )  # fmt: skip
    except KeyboardInterrupt:
        numbers = {"--scheduler": options.scheduler, "--workers": options.workers, "--count": options.count}
        more = [f"{key}={value}" for key, value in (numbers | {"--with": options.runs}).items() if value]
        more += [f"--input={text}" for text in options.input]
        again = shlex.join(["mbfmu", "study", str(options.study), "--resume", "-o", str(folder), *more])
        print(f"mbfmu: interrupted; finished runs are in {folder}. Continue with: {again}", file=sys.stderr)
        return 130
    draw(study, definition, folder)
    print_unless_quiet(options, summary(study, definition.aim))
    print_if_verbose(options, failures(study))
    print_paths(options, folder)
    return 1 if study.count("failed") == len(study.rows) else 0


def place(options: argparse.Namespace) -> Path:
    """Return the folder for the results: the one given, or a new one of the study's name, or the last to go on with."""
    from mbfmu.ensemble.records import DEFINITION_FILE

    if options.output:
        return Path(options.output)
    root = RESULTS_FOLDER / f"{file_name(options.study.stem)}-study"  # models have folders of their names there
    named = (root if n == 1 else root.with_name(f"{root.name}-{n}") for n in count(1))
    taken = []
    for folder in named:
        if not folder.exists():
            break
        if (folder / DEFINITION_FILE).exists():  # other folders there are results of other commands
            taken.append(folder)
    if not options.resume:
        return folder
    if not taken:
        raise UserError(
            f"--resume: folder {str(root)!r} does not exist; name the folder of an earlier study, or leave out --resume"
        )
    return taken[-1]


class Bar:
    """A bar of runs on a terminal, with those that failed."""

    def __init__(self, name: str, quiet: bool) -> None:
        self._bar = tqdm(unit="run", desc=name, leave=False, disable=quiet or not sys.stderr.isatty())

    def show(self, done: int, total: int, failed: int) -> None:
        """Show how far it is."""
        self._bar.total = total
        self._bar.set_postfix({"failed": failed} if failed else {}, refresh=False)
        self._bar.update(done - self._bar.n)

    def __enter__(self) -> Bar:
        return self

    def __exit__(self, *_: Any) -> None:
        self._bar.close()


def summary(study: Any, aim: Any = None) -> str:
    """Return how the runs went, and their measures."""
    import numpy as np

    lines = [f"{study.name}: {len(study.rows)} runs in {study.wall_time:.1f} s; {study.summed_time:.1f} s of CPU time"]
    lines += [f"  {line}" for line in study.replaced_inputs]
    for status, meaning in (("failed", "failed"), ("suspect", "finished with an energy error that is too large")):
        if study.count(status):
            first = next(row for row in study.rows if row["status"] == status)
            lines.append(f"  {study.count(status)} {meaning}; run {first['run']}: {first['message']}")
    for name in study.measures:
        values = study.column(name).astype(float)
        values = values[np.isfinite(values)]
        if not len(values):
            lines.append(f"  {name}: in no run")
        else:
            unit = study.units[name] if study.units[name] != "1" else ""
            low, middle, high = np.quantile(values, (0.05, 0.5, 0.95)) + 0.0
            told = f"  {name}: {middle:.6g} {unit}".rstrip() + f", 5 to 95 % {low:.6g} to {high:.6g}"
            lines.append(f"{told}, least {values.min() + 0.0:.6g}, largest {values.max() + 0.0:.6g}")
    if study.found:
        point = ", ".join(f"{name} = {value:.6g}" for name, value in study.found.point.items())
        lines.append(f"  best: {point} ({study.found.ended})")
        lines += [f"  but {doubt}" for doubt in study.found.doubts(aim)]
    return "\n".join(lines)


def failures(study: Any) -> str:
    """Return every run that is not well, with its reason."""
    odd = [row for row in study.rows if row["status"] != "ok"]
    return "\n".join(f"  run {row['run']} {row['status']}: {row['message']}" for row in odd)
