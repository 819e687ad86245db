"""Write ``docs/verification.md`` from a report of the verification suite.

Commands: ``mbfmu verify --report results/verification``, ``mbfmu verify --claims docs/claims.toml --json
results/claims.json``, then ``python docs/verification_page.py results/verification/report.json results/claims.json``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

PAGE = Path(__file__).with_name("verification.md")
HEADER = (
    "problem",
    "quantity",
    "method",
    "tolerance",
    "output",
    "t, s",
    "reference",
    "mbfmu",
    "error",
    "allowed",
    "uncertainty",
    "CPU ms",
    "verdict",
)
INTRODUCTION = """# Verification report

This page is written by `docs/verification_page.py` from the report of this command:

```bash
mbfmu verify --report results/verification
```

It runs problems whose solution is known independently of mbfmu: by closed forms, by published numbers, or by
integration with SciPy of equations in another formulation. Each problem is run with every solver that accepts it.
`mbfmu verify --quick` runs most of them at one tolerance, which takes about 40 s if all code is compiled (one core of
AMD EPYC). `--report DIR` writes `report.html`, a page without external files, and `report.json`. The exit
code is 1 if a result is wrong without a warning. [Hard cases](hard_cases.md)
compares more tolerances for singular and ill-conditioned mechanisms.

## Verdicts

{rule}

| verdict | meaning |
|---|---|
| right | The error is at most the allowed error at all times of the comparison |
| stopped | The result is right until the run stops with an error message |
| warned | The error is larger than allowed, and there is a warning or an error message |
| WRONG | The error is larger than allowed without a warning |

## Planted errors

`tests/verification/seeded_errors.py` changes the program in one place and runs a problem with and without the change.
Each of 15 errors is found: the result is right without the change, and not right with it.

| error | verdict |
|---|---|
| Sign of the centripetal acceleration; dropped gyroscopic moment; reversed gravity; transposed rotation | warned |
| Dropped damping of a spring; dropped acceleration of a drive | warned |
| Dropped parallel axis term of the inertia | The mechanism is refused |
| Gear ratio 1 % too large; half friction; phase of a harmonic load; missing constraint equation | WRONG |
| Output scaled by 1.001; tolerance 10 000 times too large | WRONG |
| Dropped gyroscopic term, or dropped constraint forces, of the linear model | WRONG |

The warnings are those of the [energy check](balance.md), which finds errors of the dynamics without a reference.

## Other engines

`mbfmu verify --engines` compares mass matrices and accelerations of 200 random trees with MuJoCo and Pinocchio, as far
as they are installed (extras `import` and `bench`). The trees have up to 12 bodies and revolute, translational,
spherical, universal, cylindrical and planar joints. The largest differences were 1e-14 (mass matrix, relative to its
largest entry) and 2e-14 (accelerations, relative to the largest one). Up to two loops by ball joints between random
points of the trees give 90 mechanisms with loops that are not nearly singular. Their accelerations differ from those of
`constraintDynamics` of Pinocchio by up to 9e-13; the mechanism with this difference has condition numbers with a
product of 4e4. Every tenth tree is simulated for 0.5 s with
`adams`, `radau` and `ida` at tolerances of 1e-6 and 1e-8. The reference is the motion that follows from the
accelerations of the other engine by SciPy (DOP853). All 240 motions were right.

## Random mechanisms with friction, stops and events

300 random mechanisms were compared with integrations by SciPy (DOP853) from event to event. The reference shares no
code with mbfmu: absolute coordinates of all bodies, with Lagrange multipliers for joints, drives, locked joints and
joints that stick. The mechanisms are planar and spatial trees of one to eight revolute, translational, universal and
ball joints, with lengths of 0.001 to 1000 m and masses of 0.0002 to 5000 kg. 289 have [joint friction](friction.md)
(184 of them static friction that is larger than that of sliding, 107 normal forces that oscillate); 226 have rigid or
elastic stops; 205 have [events](events.md) that set inputs and parameters, apply impulses, lock joints or end the
run; 161 have all three.

| friction of the reference | `deflection` | tolerance | mechanisms | right | refused | wrong | excluded |
|---|---|---|---|---|---|---|---|
| the same elastic bristle | 5e-4 to 5e-3 | 1e-8 | 150 | 146 | 0 | 0 | 4 |
| Coulomb and Stribeck friction with exact stick | 3e-7 to 3e-6 | 1e-7 | 150 | 145 | 1 | 0 | 4 |

The deflections are in rad, or in lengths of the mechanism. The solvers are `radau`, `ida` and `auto`, in the first
line also `adams` and `hybrid`.

- **Allowed error.** A motion is right if all outputs and the times of all events differ from the reference by at most
  100 times the tolerance times the sensitivity. In the second line the error of the bristle is added: three times the
  change of the motion if each change of the direction of sliding changes the rate by about sqrt(8 c F_N d / m)
  ([symbols](friction.md)), and five deflections for each of them.
- **Largest errors.** One motion exceeds the allowed error, by a factor of 1.6. Its error decreases in proportion to
  sqrt(d), and does not depend on solver and tolerance. It is counted as right, because a tenth of the deflection and
  of the tolerance reduce it to less than half. All others have at most 0.51 times the allowed error.
- **Excluded mechanisms.** Motions are compared until the allowed error exceeds a tenth of the range of an output, or
  a change of the start by 1e-6 gives other events. If this is within the first half of the time, the mechanism is
  excluded (3). It is also excluded if the reference has more than 300 events (5). Both reasons follow from the
  reference alone.
- **Refused.** The mechanism that is refused has a stop for a coordinate that is driven.
- **Rest at stops.** 28 motions that are right are compared until a body comes to rest at a rigid stop, where the
  reference ends.

An error of a thousandth of the friction coefficient would be detected. `python -m tests.switched.campaign` repeats
the comparison from a copy of the repository.

**Locks in loops.** Loops of five bars with a pendulum, of random sizes, in which up to all joints are
[locked](events.md#locked-joints) and released, were compared in the same way in 206 runs
(`tests/loops/test_random_locks_in_loops.py`). A small error in such a motion grows by the factor exp(6 t) until the
time t in s. The errors of the angles are at most 0.5 times the tolerance times this factor in small models, and 2.1
times in large ones.

## Numbers of the documentation

`docs/claims.toml` lists statements of the documentation on accuracy and speed, each with a function that measures its
number, or with the command that measures a table. `mbfmu verify --claims docs/claims.toml` measures the numbers again
with the functions, in two minutes. Its exit code is 1 if a statement on accuracy does not hold, or a page no longer
contains a statement of the list; ratios of computing times that differ are reported. The other statements need the
command that is listed, which takes minutes to hours.

{claims}
"""


def number(value: float | None, digits: int) -> str:
    """Return a number with significant digits; a dash if there is none."""
    return "-" if value is None else f"{value:.{digits}g}".replace("e-0", "e-").replace("e+0", "e")


def row(line: dict[str, Any]) -> str:
    """Return a line of the table of results."""
    cells = (
        line["problem"],
        f"{line['quantity']}, {line['unit']}",
        f"`{line['method']}`",
        number(line["tolerance"], 1),
        line["output"] or "-",
        number(line["time"], 4),
        number(line["reference"], 9),
        number(line["value"], 9),
        number(line["error"], 2),
        number(line["allowed"], 2),
        number(line["uncertainty"], 1),
        f"{1e3 * line['seconds']:.0f}",
        line["verdict"],
    )
    return f"| {' | '.join(cells)} |"


def describe(problem: dict[str, Any]) -> str:
    """Return a line of the table of problems."""
    sources = []
    for source in problem["sources"]:
        text = f"{source['authors']} ({source['year']}): {source['title']}"
        sources.append(f"[{text}]({source['link']})" if source["link"] else text)
    named = "; ".join(sources) or "devised for this suite"
    return f"| {problem['name']} | {problem['description']} | {problem['reference']} | {named} |"


def claims_table(claims: dict[str, Any]) -> str:
    """Return the result of measuring the claims: numbers by page, and the claims that do not hold."""
    found = claims["claims"]
    lines = [
        f"{claims['environment']}. {claims['summary']}.\n",
        "| page | statements | measured | not as stated | by a command |",
        "|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(claim["page"] for claim in found):
        own = [claim for claim in found if claim["page"] == name]
        measured = [claim for claim in own if claim["number"] is not None]
        changed = sum(claim["verdict"] != "holds" for claim in measured)
        lines.append(f"| `{name}` | {len(own)} | {len(measured)} | {changed} | {len(own) - len(measured)} |")
    lines += [
        f"\n`{claim['page']}`: {claim['text'].replace('|', ' ').strip()}: measured {number(claim['number'], 3)}, "
        f"stated {number(claim['range'][0], 3)} to {number(claim['range'][1], 3)} (`{claim['method']}`)."
        for claim in found
        if claim["number"] is not None and claim["verdict"] != "holds"
    ]
    return "\n".join(lines)


def page(report: dict[str, Any], claims: dict[str, Any]) -> str:
    """Return the page for the contents of ``report.json`` and of the file with the measured claims."""
    lines = report["results"]
    messages = [
        f"- {line['problem']}, `{line['method']}` at {number(line['tolerance'], 1)}: {line['verdict']}. "
        + line["reason"]
        for line in lines
        if line["reason"]
    ]
    parts = [
        INTRODUCTION.format(rule=report["rule"], claims=claims_table(claims)),
        f"## Results\n\n{report['environment']}. {report['summary']}.",
        report["comparison"] + "\n",
        f"| {' | '.join(HEADER)} |\n|{'---|' * len(HEADER)}",
        "\n".join(row(line) for line in lines),
        "\n" + "\n".join(messages) if messages else "",
        "\n## Problems and references\n\n| problem | mechanism | reference | source |\n|---|---|---|---|",
        "\n".join(describe(problem) for problem in report["problems"]),
        "\n## Limits of the suite\n",
        "\n".join(f"- {text}" for text in report["not_covered"]),
    ]
    return "\n".join(filter(None, parts)) + "\n"


def main() -> None:
    """Write the page."""
    report, claims = (json.loads(Path(name).read_text()) for name in sys.argv[1:])
    PAGE.write_text(page(report, claims))


if __name__ == "__main__":
    main()
