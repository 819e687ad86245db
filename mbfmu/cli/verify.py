"""``mbfmu verify``."""

from __future__ import annotations

import argparse
from pathlib import Path

from mbfmu.modeling.settings import check_setting
from mbfmu.util.errors import UserError
from mbfmu.util.files import write_text

from .common import (
    Commands,
    add_json,
    bar,
    folder,
    print_if_verbose,
    print_paths,
    print_unless_quiet,
    reader,
    writable,
    write_json,
)

SEEDS_PER_MOTION = 10  # random mechanisms of which one is simulated
VERIFY_EXAMPLES = """examples:
  mbfmu verify --quick
  mbfmu verify --quick --report verification     write verification/report.html and verification/report.json
  mbfmu verify --only "A0*" --solver ida --tolerance 1e-8
  mbfmu verify --list                            names and descriptions of the problems
  mbfmu verify --engines                         random mechanisms by other engines: accelerations and motions
  mbfmu verify --claims docs/claims.toml         measure numbers of the documentation again
"""


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu verify``."""
    p = commands.add_parser(
        "verify",
        help=about,
        description="""Simulate problems whose solution is known independently of mbfmu: by closed forms, published
numbers, or integration by SciPy of equations in another formulation. Each is run with every solver that accepts it.

Verdicts: right; stopped (right until an error message); warned (wrong, with a warning or an error message); WRONG
(without a warning). The exit code is 1 if a result is WRONG.""",
        epilog=VERIFY_EXAMPLES,
    )
    p.add_argument("--quick", action="store_true", help="only problems that need little time, at one tolerance")
    p.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="NAME",
        help="name of a problem, its beginning, or a pattern such as 'A0*'; may be repeated",
    )
    p.add_argument(
        "--solver", action="append", default=[], metavar="NAME", help="solver; may be repeated (default: all)"
    )
    p.add_argument(
        "--tolerance",
        action="append",
        type=reader(float),
        metavar="X",
        help="tolerance; may be repeated (default: 1e-6 and 1e-8; with --quick 1e-6)",
    )
    p.add_argument("--report", type=Path, metavar="DIR", help="write report.html and report.json to this folder")
    mode = p.add_mutually_exclusive_group()
    mode.add_argument("--list", action="store_true", help="list the problems and run nothing")
    mode.add_argument(
        "--engines",
        type=reader(int),
        nargs="?",
        const=200,
        metavar="N",
        help="compare mass matrices and accelerations of N random mechanisms (default 200), and motions of every "
        "tenth of them, with MuJoCo and Pinocchio as far as they are installed, and run no problem",
    )
    mode.add_argument(
        "--claims",
        type=Path,
        metavar="FILE",
        help="measure the numbers of the documentation that are listed in this TOML file, and run no problem; the exit "
        "code is 1 if a statement on accuracy does not hold",
    )
    add_json(p)
    p.set_defaults(command=command_verify)


def command_verify(options: argparse.Namespace) -> int:
    """Run the suite, print the table and write the report."""
    for mode in ("claims", "engines"):
        if getattr(options, mode) is not None:
            refuse_without_effect(options, mode)
            return command_claims(options) if mode == "claims" else command_engines(options)
    from mbfmu.verification.report import as_dict, as_page, as_text
    from mbfmu.verification.suite import QUICK_TOLERANCES, TOLERANCES, has_wrong, select, verify

    problems = select(options.only, quick=options.quick)
    if options.list:
        print("\n".join(f"{problem.name}: {problem.description}" for problem in problems))
        return 0
    for name in options.solver:
        check_setting("solver", name)
    tolerances = options.tolerance or (QUICK_TOLERANCES if options.quick else TOLERANCES)
    for tolerance in tolerances:
        check_setting("tolerance", tolerance)
    if options.report:
        folder(options.report)
        writable(options.report / "report.html")
        writable(options.report / "report.json")
    if options.json:
        writable(options.json)
    lines, reached = [], 0.0
    with bar(100, "verify", options.quiet, "%") as shown:

        def done(name: str, share: float) -> None:
            nonlocal reached
            reached += 100.0 * share
            shown.update(int(reached + 1e-6) - shown.n)
            print_if_verbose(options, f"done: {name}")

        for line in verify(problems, solvers=options.solver, tolerances=tolerances, progress=done):
            lines.append(line)
    if not lines:
        raise UserError(f"no problem accepts the solver {', '.join(options.solver)}; use another solver or no --only")
    content = as_dict(problems, lines)
    if str(options.json) != "-":
        print_unless_quiet(options, as_text(lines))
    if options.json:
        write_json(content, options.json)
    if options.report:
        write_text(options.report / "report.html", as_page(problems, lines))
        write_json(content, options.report / "report.json")
        if str(options.json) != "-":
            print_paths(options, options.report / "report.html")
    return int(has_wrong(lines))


def refuse_without_effect(options: argparse.Namespace, mode: str) -> None:
    """Raise UserError if an option is given that selects problems, which are not run in this mode."""
    for name in ("quick", "only", "solver", "tolerance", "report"):
        if getattr(options, name):
            raise UserError(f"--{name} has no effect with --{mode}, which runs no problem; leave one of them out")


def command_claims(options: argparse.Namespace) -> int:
    """Measure the claims of a file; their pages are in the folder above it."""
    from mbfmu.verification.claims import as_dict, as_text, has_failed, measure_claims, read_claims

    claims, measured = read_claims(options.claims), []
    if options.json:
        writable(options.json)
    with bar(len(claims), "claims", options.quiet) as shown:
        for found in measure_claims(claims, options.claims.resolve().parent.parent):
            measured.append(found)
            shown.update()
    if str(options.json) != "-":
        print_unless_quiet(options, as_text(measured))
    if options.json:
        write_json(as_dict(measured), options.json)
    return int(has_failed(measured))


def command_engines(options: argparse.Namespace) -> int:
    """Compare random mechanisms, and motions of every tenth of them, with other engines."""
    from mbfmu.verification.engines.compare import ENGINES, as_dict, as_text, compare_engines, installed_engines
    from mbfmu.verification.engines.loops import compare_random_loops
    from mbfmu.verification.engines.motions import compare_motions
    from mbfmu.verification.report import as_text as lines_as_text
    from mbfmu.verification.suite import has_wrong

    if options.engines < 1:
        raise UserError(f"--engines is {options.engines}; allowed: a whole number from 1 on")
    if not (names := installed_engines()):
        raise UserError(f"no other engine is installed; install one of the packages {', '.join(ENGINES)}")
    if options.json:
        writable(options.json)
    is_text = str(options.json) != "-"
    with bar(options.engines * len(names), "dynamics", options.quiet) as shown:
        found = compare_engines(options.engines, lambda _: shown.update())
    if "pinocchio" in names:
        with bar(options.engines, "loops", options.quiet) as shown:
            found.append(compare_random_loops(options.engines, lambda _: shown.update()))
    if is_text:
        print_unless_quiet(options, as_text(found))
    seeds, lines = range(0, options.engines, SEEDS_PER_MOTION), []
    with bar(len(seeds) * len(names), "motions", options.quiet) as shown:
        for name in names:
            for seed in seeds:
                lines += compare_motions(seed, name)
                shown.update()
    if is_text:
        print_unless_quiet(options, lines_as_text(lines))
    if options.json:
        write_json({"differences": as_dict(found), "motions": [line.as_dict() for line in lines]}, options.json)
    return int(not all(difference.is_right for difference in found) or has_wrong(lines))
