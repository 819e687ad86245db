"""Draw the flowchart of the page on solvers: ``python docs/which_solver.py`` writes the picture."""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import escape

PICTURE = Path(__file__).parent / "images" / "which_solver.svg"
QUESTIONS = (  # lines of a question, and of the answer if it is yes
    (("Do you need the steady state", "instead of the motion?"), ("mbfmu equilibrium", "no simulation")),
    (
        (
            "Is the model stiff: a sheet, a mesh,",
            "a stiff damped spring? (with adams many",
            "steps are limited by stability)",
        ),
        ("radau; if large: esdirk or ida", "tolerance: 1/100 (ida: 1/1000)"),
    ),
    (
        ("Does the model have 10 or more constraint", "equations, and at most 60 coordinates?"),
        ("hybrid", "tolerance: 1/100 of the error"),
    ),
)
LAST = ("adams", "tolerance: 1/100 of the error")
WIDTH, ROW, LINE = 720, 108, 19  # pixels
QUESTION, ANSWER = (20, 330), (440, 260)  # left edge and width of a column
INK, BLUE, PAPER = "#1b2733", "#4269d0", "#ffffff"


def box(left: float, top: float, width: float, lines: tuple[str, ...], strong: bool) -> str:
    """Return a box with lines of text in its middle; the first line of an answer is a name."""
    height = LINE * len(lines) + 22
    fill, edge = ("#e8edfa", BLUE) if strong else ("#f6f7f9", "#8b97a4")
    parts = [
        f'<rect x="{left}" y="{top}" width="{width}" height="{height}" rx="8" fill="{fill}" stroke="{edge}"'
        ' stroke-width="1.5"/>'
    ]
    for k, line in enumerate(lines):
        weight = ' font-weight="bold"' if strong and k == 0 else ""
        parts.append(
            f'<text x="{left + width / 2}" y="{top + 11 + LINE * (k + 0.75)}" text-anchor="middle"{weight}>'
            f"{escape(line)}</text>"
        )
    return "\n".join(parts)


def arrow(x: float, y: float, dx: float, dy: float, word: str) -> str:
    """Return an arrow with a word beside its beginning."""
    place = (x + 14, y - 6) if dx else (x + 8, y + 17)
    return (
        f'<line x1="{x}" y1="{y}" x2="{x + dx}" y2="{y + dy}" stroke="{INK}" stroke-width="1.5"'
        f' marker-end="url(#tip)"/>\n<text x="{place[0]}" y="{place[1]}" font-style="italic">{word}</text>'
    )


def picture() -> str:
    """Return the picture as SVG."""
    parts, top = [], 20.0
    for question, answer in QUESTIONS:
        height = LINE * len(question) + 22
        parts.append(box(QUESTION[0], top, QUESTION[1], question, strong=False))
        middle = top + height / 2
        parts.append(box(ANSWER[0], middle - LINE - 11, ANSWER[1], answer, strong=True))
        right = QUESTION[0] + QUESTION[1]
        parts.append(arrow(right, middle, ANSWER[0] - right - 8, 0, "yes"))
        parts.append(arrow(QUESTION[0] + QUESTION[1] / 2, top + height, 0, ROW - height - 8, "no"))
        top += ROW
    parts.append(box(QUESTION[0], top, QUESTION[1], LAST, strong=True))
    height = top + 2 * LINE + 22 + 20
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:g}" width="{WIDTH}"'
            f' height="{height:g}" font-family="sans-serif" font-size="14" fill="{INK}">',
            "<title>Which solver: a decision in four questions</title>",
            '<defs><marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8"'
            f' orient="auto"><path d="M0 0 L10 5 L0 10 z" fill="{INK}"/></marker></defs>',
            f'<rect width="{WIDTH}" height="{height:g}" fill="{PAPER}"/>',
            *parts,
            "</svg>\n",
        ]
    )


if __name__ == "__main__":
    PICTURE.write_text(picture())
