"""Write ``docs/verification.md`` from a report of the verification suite.

Commands: ``mbfmu verify --report results/verification``, then
``python docs/verification_page.py results/verification/report.json``.
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
largest entry) and 2e-14 (accelerations, relative to the largest one). Every tenth tree is simulated for 0.5 s with
`adams`, `radau` and `ida` at tolerances of 1e-6 and 1e-8. The reference is the motion that follows from the
accelerations of the other engine by SciPy (DOP853). All 240 motions were right.

## Numbers of the documentation

`docs/claims.toml` lists numbers of README.md and of the first page that state accuracy or speed, with the function or
the command that measures each. `mbfmu verify --claims docs/claims.toml` measures them again. Its exit code is 1 if a
statement on accuracy does not hold, or a page no longer contains a statement of the list.
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


def page(report: dict[str, Any]) -> str:
    """Return the page for the content of ``report.json``."""
    lines = report["results"]
    messages = [
        f"- {line['problem']}, `{line['method']}` at {number(line['tolerance'], 1)}: {line['verdict']}. "
        + line["reason"]
        for line in lines
        if line["reason"]
    ]
    parts = [
        INTRODUCTION.format(rule=report["rule"]),
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
    PAGE.write_text(page(json.loads(Path(sys.argv[1]).read_text())))


if __name__ == "__main__":
    main()
