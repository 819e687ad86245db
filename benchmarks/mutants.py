"""Which errors in the recursions the tests do not find.

A mutant is the program with one error in one function of ``mbfmu/mechanics/recursions``: another sign, factor, index or
comparison, or a call left out. The tests that concern the file run on it without compilation until one fails; a mutant
that passes them has survived. A survivor is a gap in the tests, or a change without effect (in code that only saves
work, or that a later line makes good).

    python benchmarks/mutants.py --count 150           # 150 mutants of all recursions, drawn at random
    python benchmarks/mutants.py --file aba.py --all   # every mutant of one file
    python benchmarks/mutants.py --file aba.py --function apply_inverse_mass_matrix --all

Each mutant runs in a fork of this process, which has imported everything: the changed function gets its code there.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import copy
import importlib
import os
import random
import resource
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, NoReturn

os.environ["NUMBA_DISABLE_JIT"] = "1"  # before numba is imported

import pytest
from hypothesis import Phase, settings

ROOT = Path(__file__).resolve().parents[1]
RECURSIONS = "mbfmu.mechanics.recursions"
OPTIONS = ["-x", "-q", "-n0", "-pno:cacheprovider", "-Wignore::pytest.PytestAssertRewriteWarning"]
OPTIONS += ["--hypothesis-profile=mutants"]
TIME_LIMIT = 600  # s of computing time, of the tests of one mutant; a mutant that needs longer has been found
FAILED = (1, 2, -signal.SIGXCPU)  # exit codes of pytest: a test, or its import, has failed; the time is over
NOT_RUN = 70
RESULTS = SURVIVES, FOUND, NOT_TRIED = "SURVIVES", "found", "NOT RUN"
OPPOSITE: dict[type[ast.operator], type[ast.operator]] = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add}
MECHANICS = "tests/mechanics/"
SHORT = MECHANICS + "test_recursion_identities.py"
DYNAMICS = [
    MECHANICS + "test_identities.py::" + name
    for name in (
        "test_mass_matrix_is_inverse_dynamics_by_columns",
        "test_kinetic_energy_is_the_mass_matrix_form",
        "test_inverse_dynamics_undoes_articulated_body",
        "test_articulated_body_with_a_drive_agrees_with_the_free_equations",
    )
]
ELASTIC = [
    MECHANICS + "test_elastic.py::" + name
    for name in (
        "test_mass_matrix_inverse_dynamics_and_articulated_body_agree",
        "test_kinetic_energy_is_the_mass_matrix_form_and_power_is_its_rate",
        "test_constraint_jacobian_and_gamma_are_derivatives",
    )
]
IDENTITIES = MECHANICS + "test_identities.py"
POWER = [
    MECHANICS + "test_power.py::" + name
    for name in (
        "test_power_of_a_tree_is_the_rate_of_its_energy",
        "test_power_of_loops_is_the_rate_of_their_energy",
        "test_exposure_is_momentum_and_bias_by_tolerance",
        "test_exposure_counts_a_drive_by_its_effort_and_momentum",
        "test_power_of_elastic_bodies_is_the_rate_of_their_energy[beams-False]",
        "test_power_of_elastic_bodies_is_the_rate_of_their_energy[beams-True]",
    )
]
# the short ones first: most mutants are found by them
TESTS: dict[str, list[str]] = {
    "kinematics.py": [SHORT, *DYNAMICS, IDENTITIES],
    "rnea.py": [SHORT, *DYNAMICS, *ELASTIC, IDENTITIES],
    "aba.py": [SHORT, *DYNAMICS[2:], ELASTIC[0]],
    "crba.py": [SHORT, *DYNAMICS[:2], *ELASTIC[:2]],
    "constraints.py": [ELASTIC[2], IDENTITIES, *POWER],
    "energy.py": [SHORT, DYNAMICS[1], ELASTIC[1], *POWER],
    "applied.py": [*ELASTIC[:2], *POWER, IDENTITIES],
}


class Mutant(NamedTuple):
    """A changed function."""

    file: str
    function: str
    line: int
    before: str
    after: str
    source: str  # of the whole file


def list_mutants(file: str) -> Iterator[Mutant]:
    """Yield every mutant of one file."""
    tree = ast.parse((ROOT / "mbfmu/mechanics/recursions" / file).read_text(encoding="utf-8"))
    for function in tree.body:
        if not isinstance(function, ast.FunctionDef):
            continue
        for number, node in enumerate(ast.walk(function)):
            for change in range(2):
                changed = copy.deepcopy(tree)
                twin = next(f for f in changed.body if isinstance(f, ast.FunctionDef) and f.name == function.name)
                target = list(ast.walk(twin))[number]
                before = ast.unparse(node) if isinstance(node, ast.expr | ast.stmt) else ""
                if mutate(target, change):
                    after = ast.unparse(target)
                    yield Mutant(file, function.name, node.lineno, before, after, ast.unparse(changed))  # type: ignore[attr-defined]


def mutate(node: ast.AST, change: int) -> bool:
    """Change a node in place in one of two ways; False if there is no such way."""
    if isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in OPPOSITE and change == 0:
        node.op = OPPOSITE[type(node.op)]()
        return True
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and change == 0:
        node.op = ast.UAdd()
        return True
    if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.Lt | ast.GtE) and change == 0:
        node.ops[0] = ast.LtE() if isinstance(node.ops[0], ast.Lt) else ast.Gt()
        return True
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call) and change == 0:
        node.value = ast.Constant(None)
        return True
    if isinstance(node, ast.Constant) and isinstance(node.value, float) and node.value:
        node.value *= 2.0 if change else -1.0
        return True
    if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant) and isinstance(node.slice.value, int):
        if change:
            node.slice.value = max(node.slice.value - 1, 0) if node.slice.value else 1
            return True
        return False
    if (
        isinstance(node, ast.Subscript)
        and isinstance(node.slice, ast.Tuple)
        and len(node.slice.elts) == 2
        and not change
    ):
        node.slice.elts.reverse()
        return ast.dump(node.slice.elts[0]) != ast.dump(node.slice.elts[1])
    return False


def try_tests(mutant: Mutant | None, tests: list[str]) -> str:
    """Return what the tests find with this change, or without any: one of RESULTS."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        run_tests(mutant, tests)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return SURVIVES if code == 0 else FOUND if code in FAILED else NOT_TRIED


def run_tests(mutant: Mutant | None, tests: list[str]) -> NoReturn:
    """End this process with the exit code of pytest."""
    code = NOT_RUN
    try:
        used = int(resource.getrusage(resource.RUSAGE_SELF).ru_utime)
        resource.setrlimit(resource.RLIMIT_CPU, (used + TIME_LIMIT, resource.RLIM_INFINITY))  # ends this process
        if mutant is not None:
            inject_error(mutant)
        with (
            Path(os.devnull).open("w") as nowhere,
            contextlib.redirect_stdout(nowhere),
            contextlib.redirect_stderr(nowhere),
        ):
            code = int(pytest.main([*OPTIONS, *tests]))
    finally:
        os._exit(code)


def inject_error(mutant: Mutant) -> None:
    """Give the function the code of the mutant: other modules have imported the function itself."""
    module = importlib.import_module(f"{RECURSIONS}.{mutant.file[:-3]}")
    space = dict(vars(module))
    exec(compile(mutant.source, mutant.file, "exec"), space)
    getattr(module, mutant.function).__code__ = space[mutant.function].__code__


def main() -> None:
    """Report the mutants that no test detects."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--file", choices=TESTS, help="of this file alone")
    parser.add_argument("--function", help="of this function alone")
    parser.add_argument("--count", type=int, default=20, help="how many, drawn at random")
    parser.add_argument("--all", action="store_true", help="all of them")
    parser.add_argument("--seed", type=int, default=0, help="of the draw")
    given = parser.parse_args()
    os.chdir(ROOT)
    phases = [Phase.explicit, Phase.generate]  # a failure is not made smaller
    settings.register_profile("mutants", max_examples=5, deadline=None, derandomize=True, database=None, phases=phases)
    found = [m for file in ([given.file] if given.file else TESTS) for m in list_mutants(file)]
    found = [m for m in found if given.function in (None, m.function)]
    if not given.all:
        found = random.Random(given.seed).sample(found, min(given.count, len(found)))
    files = list(dict.fromkeys(m.file for m in found))
    for file in files:
        importlib.import_module(f"{RECURSIONS}.{file[:-3]}")
    if try_tests(None, list(dict.fromkeys(test for file in files for test in TESTS[file]))) != SURVIVES:
        sys.exit("the tests fail without a mutation")
    counts: dict[str, Counter[str]] = {file: Counter() for file in files}
    for mutant in found:
        result = try_tests(mutant, TESTS[mutant.file])
        counts[mutant.file][result] += 1
        place = f"{mutant.file}:{mutant.line} {mutant.function}"
        print(f"{result:8} {place}: {mutant.before}  ->  {mutant.after}", flush=True)
    print("| file | mutants | survive | found | not run |\n|---|---|---|---|---|")
    for file, count in (counts | {"all": sum(counts.values(), Counter[str]())}).items():
        print(f"| {file} | {count.total()} | " + " | ".join(str(count[result]) for result in RESULTS) + " |")


if __name__ == "__main__":
    main()
