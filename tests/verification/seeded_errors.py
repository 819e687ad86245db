"""Errors that are planted in the program, one at a time, to show that the verification suite finds them.

    python tests/verification/seeded_errors.py                 # all
    python tests/verification/seeded_errors.py "half friction" # one of them
    python tests/verification/seeded_errors.py --list          # names

The program runs without compilation: each error is a changed line of one function, in a fork of this process. One line
is printed for each: its name, and the verdict of the suite without and with the error.
"""

from __future__ import annotations

import importlib
import inspect
import json
import os
import sys
import textwrap
from pathlib import Path
from typing import Any, NamedTuple

os.environ["NUMBA_DISABLE_JIT"] = "1"  # before numba is imported

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
MECHANICS = "mbfmu.mechanics"
TOLERANCE = 1e-6
NOT_PLANTED = "not planted"


class Change(NamedTuple):
    """A text of one function and what replaces it; the function may be a method, as ``Class.method``."""

    module: str
    function: str
    before: str
    after: str


class Seed(NamedTuple):
    """An error, and the problem and solver that must find it."""

    name: str
    changes: tuple[Change, ...]
    problem: str
    method: str


KINEMATICS = f"{MECHANICS}.recursions.kinematics"
RNEA = f"{MECHANICS}.recursions.rnea"
SEEDS = (
    Seed(
        "sign of the centripetal acceleration",
        (Change(RNEA, "inertia_wrench", "+ wy * pz - wz * py", "- wy * pz + wz * py"),),
        "sprung four-bar",
        "adams",
    ),
    Seed(
        "dropped gyroscopic moment",
        (Change(RNEA, "inertia_wrench", "out[3] += wy * hz - wz * hy + c[1]", "out[3] += c[1]"),),
        "Euler top",
        "adams",
    ),
    Seed(
        "reversed gravity",
        (
            Change(KINEMATICS, "update_accelerations", "-arrays.world", "arrays.world"),
            Change(f"{MECHANICS}.recursions.aba", "forward_dynamics", "-arrays.world", "arrays.world"),
        ),
        "A01 pendulum",
        "adams",
    ),
    Seed(
        "dropped parallel axis term",
        (
            Change(
                f"{MECHANICS}.recursions.crba",
                "accumulate_composite_inertia",
                "m * rho[k] + 2.0 * mc[k]",
                "2.0 * mc[k]",
            ),
        ),
        "sprung four-bar",
        "adams",
    ),
    Seed(
        "gear ratio one percent too large",
        (Change(f"{MECHANICS}.couplings.gear", "evaluate", "gear.ratio", "1.01 * gear.ratio"),),
        "geared shafts",
        "adams",
    ),
    Seed(
        "missing constraint equation",
        (Change(f"{MECHANICS}.cuts.universal", "evaluate", "constrain_perpendicular(cut, 2, 2, A, B, ", "id("),),
        "Cardan shafts",
        "adams",
    ),
    Seed(
        "transposed rotation of a quaternion",
        (
            Change(f"{MECHANICS}.spatial", "quaternion_matrix", " - w * ", " @ w * "),
            Change(f"{MECHANICS}.spatial", "quaternion_matrix", " + w * ", " - w * "),
            Change(f"{MECHANICS}.spatial", "quaternion_matrix", " @ w * ", " + w * "),
        ),
        "Stewart platform",
        "adams",
    ),
    Seed(
        "half friction",
        (Change(f"{MECHANICS}.loads.bristle", "bristle_factors", "force.coulomb *", "0.5 * force.coulomb *"),),
        "incline, slipping",
        "radau",
    ),
    Seed(
        "phase of a harmonic load",
        (Change(f"{MECHANICS}.signals.harmonic", "evaluate", "np.sin(phase)", "np.cos(phase)"),),
        "forced oscillator",
        "adams",
    ),
    Seed(
        "dropped damping of a spring",
        (Change(f"{MECHANICS}.loads.joint_spring", "apply", " + force.damping * state.v[force.v]", ""),),
        "forced oscillator",
        "adams",
    ),
    Seed(
        "dropped acceleration of a drive",
        (Change(KINEMATICS, "scatter_coordinates", "state.a[body.vi] = signal(", "_ = signal("),),
        "car axis",
        "adams",
    ),
    Seed(
        "output scaled by 1.001",
        (
            Change(
                f"{MECHANICS}.sensors.points",
                "position",
                "arm(here, sensor.point)[k]",
                "1.001 * arm(here, sensor.point)[k]",
            ),
        ),
        "A01 pendulum",
        "adams",
    ),
    Seed(
        "tolerance ten thousand times too large",
        (Change("mbfmu.modeling.settings", "Settings.options", "rtol=self.tolerance", "rtol=1e4 * self.tolerance"),),
        "A01 pendulum",
        "adams",
    ),
    Seed(
        "dropped constraint forces of the linear model",
        (Change("solvers.statics.matrices", "_dense_terms", "(terms.h + terms.J.T @ lam)", "terms.h"),),
        "governor with rods",
        "equilibrium",
    ),
    Seed(
        "dropped gyroscopic term of the linear model",
        (Change("solvers.statics.matrices", "_dense_terms", "C[:, k] = terms", "C[:, k] = 0.0 * terms"),),
        "whirl",
        "modes",
    ),
)


def plant(changes: tuple[Change, ...]) -> None:
    """Give functions the code of their changed source: other modules have imported the functions themselves."""
    sources: dict[tuple[str, str], str] = {}
    for change in changes:
        owner: Any = importlib.import_module(change.module)
        *classes, name = change.function.split(".")
        for part in classes:
            owner = getattr(owner, part)
        function = getattr(owner, name)
        source = sources.get(change[:2]) or textwrap.dedent(inspect.getsource(function))
        if change.before not in source:
            raise ValueError(f"{change.function} of {change.module} does not contain {change.before!r}")
        sources[change[:2]] = source.replace(change.before, change.after)
    for (module, path), source in sources.items():
        owner = importlib.import_module(module)
        *classes, name = path.split(".")
        for part in classes:
            owner = getattr(owner, part)
        function = getattr(owner, name)
        space = dict(function.__globals__)
        exec(compile(f"from __future__ import annotations\n{source}", module, "exec"), space)
        function.__code__ = space[name].__code__


def verdicts(seed: Seed, *, planted: bool) -> list[str]:
    """Return the verdicts of the suite in a fork of this process; ``ended`` if the program raised an exception."""
    from mbfmu.verification.suite import PROBLEMS
    from mbfmu.verification.verdict import check

    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        found = ["ended"]
        try:
            os.close(reading)
            if planted:
                try:
                    plant(seed.changes)
                except (AttributeError, ImportError, ValueError) as error:
                    found = [f"{NOT_PLANTED}: {error}"]
                    raise
            (problem,) = (p for p in PROBLEMS if p.name == seed.problem)
            found = [line.verdict for line in check(problem, [seed.method], [TOLERANCE])]
        except Exception as error:
            if not found[0].startswith(NOT_PLANTED):
                found = [f"ended: {error}"]
        finally:
            os.write(writing, json.dumps(found).encode())
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        answer: list[str] = json.loads(pipe.read())
    os.waitpid(child, 0)
    return answer


def main() -> None:
    """Print the verdicts of the chosen errors."""
    if sys.argv[1:] == ["--list"]:
        print("\n".join(seed.name for seed in SEEDS))
        return
    names = sys.argv[1:] or [seed.name for seed in SEEDS]
    for seed in SEEDS:
        if seed.name in names:
            found = {planted: verdicts(seed, planted=planted) for planted in (False, True)}
            print(json.dumps({"name": seed.name, "right": found[False], "planted": found[True]}), flush=True)


if __name__ == "__main__":
    main()
