"""The blocks of the page of questions print the numbers that stand below them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[1] / "docs" / "questions.md"
BLOCKS = re.findall(r"\n## (.*?)\n.*?```python\n(.*?)```\n\n```text\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
NUMBER = r"-?\d+\.\d+(?:e[-+]\d+)?"
ROUNDING = 1e-12  # errors below it depend on the order of operations
MARGIN = 3.0  # of errors: steps differ with the version of SUNDIALS and of the compiler


def test_every_question_has_a_block() -> None:
    assert len(BLOCKS) == PAGE.read_text().count("\n## ") == 7


@pytest.mark.filterwarnings("ignore")  # the sheet of the capstan is coarse, as the page states
@pytest.mark.parametrize(("title", "code", "printed"), BLOCKS, ids=[title for title, *_ in BLOCKS])
def test_a_block_prints_what_the_page_states(
    title: str, code: str, printed: str, capfd: pytest.CaptureFixture[str]
) -> None:
    exec(compile(code, title, "exec"), {})
    found = capfd.readouterr().out.splitlines()
    for line, expected in zip(found, printed.splitlines(), strict=True):
        assert re.sub(NUMBER, "", line) == re.sub(NUMBER, "", expected)
        numbers = zip(re.findall(NUMBER, line), re.findall(NUMBER, expected), strict=True)
        for value, stated in numbers:
            if "error" in line or "difference" in line:
                assert float(value) <= max(MARGIN * float(stated), ROUNDING)
            else:  # to the last digit that is printed
                assert float(value) == pytest.approx(float(stated), abs=1.01 * 10.0 ** -len(stated.split(".")[1]))
