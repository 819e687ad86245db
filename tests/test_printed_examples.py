"""The examples of pages that tests/test_extending.py does not run print what their comments state."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from .test_extending import MODELLING

ROOT = Path(__file__).parents[1]
PRINTED = re.compile(r"^\s*print\(.*\)  # (.*)$", re.MULTILINE)
OTHERS = {"extending", "fmpy", "importing", "tour"}  # pages whose examples need files, which other tests write
PAGES = sorted(page for page in (ROOT / "docs").rglob("*.md") if page.stem not in OTHERS.union(MODELLING))
EXAMPLES = [
    pytest.param(page, k, block, id=f"{page.stem}-{k}")
    for page in PAGES
    for k, block in enumerate(re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL))
    if PRINTED.search(block)
]


@pytest.mark.filterwarnings("ignore")  # a page states the warnings of its examples
@pytest.mark.parametrize(("page", "number", "block"), EXAMPLES)
def test_examples_print_what_their_comments_state(
    page: Path,
    number: int,
    block: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every line of the output is in the comments of the prints, in this order. Blocks before it on the page run first
    if it does not import the package.
    """
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL)[: number + 1]
    first = max(k for k in range(number + 1) if "import mbfmu" in blocks[k] or k == 0)
    names: dict[str, object] = {}
    for earlier in blocks[first:number]:
        exec(compile(earlier, str(page), "exec"), names)
    capsys.readouterr()
    exec(compile(block, str(page), "exec"), names)
    comments, place = " ".join(PRINTED.findall(block)), 0
    for line in capsys.readouterr().out.splitlines():
        place = comments.find(line.strip(), place)
        assert place >= 0, f"{line!r} is not in {comments!r}"
