"""The list of numbers that the documentation states."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mbfmu.cli import main
from mbfmu.util.errors import UserError
from mbfmu.verification import claims
from mbfmu.verification.claims import MEASURES, Claim, as_text, has_failed, measure_claims, read_claims

ROOT = Path(__file__).parents[2]
LIST = ROOT / "docs/claims.toml"


def test_every_claim_is_in_its_page(monkeypatch: pytest.MonkeyPatch) -> None:
    listed = read_claims(LIST)
    monkeypatch.setattr(claims, "MEASURES", dict.fromkeys(MEASURES, lambda *_: 1.0))
    found = list(measure_claims(listed, ROOT))
    assert len(found) >= 100
    assert [measured.claim.text for measured in found if measured.verdict == claims.OUTDATED] == []


def test_measures_of_few_seconds_hold() -> None:
    measures = ("least_tolerance", "frequency_error_of_clamped_bar")
    chosen = [claim for claim in read_claims(LIST) if claim.measure in measures]
    found = list(measure_claims(chosen, ROOT))
    assert len(found) == 6
    assert [measured.verdict for measured in found] == ["holds"] * 6, as_text(found)


def test_what_cannot_be_measured_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> float:
        raise UserError("this needs the package 'skfem'")

    monkeypatch.setitem(MEASURES, "passages_of_four_bar", missing)
    claim = Claim(page="README.md", text="x", kind="accuracy", measure="passages_of_four_bar")
    found = claims.measure(claim)
    assert (found.verdict, found.number) == (claims.NOT_MEASURED, None)
    assert "skfem" in as_text([found])
    assert not has_failed([found])


def test_the_four_bar_passes_its_singular_configuration_as_stated() -> None:
    chosen = [claim for claim in read_claims(LIST) if claim.measure == "passages_of_four_bar"]
    found = list(measure_claims(chosen, ROOT))
    assert [measured.verdict for measured in found] == ["holds"] * 2
    assert not has_failed(found)


def test_a_claim_that_does_not_hold_is_marked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(claims, "MEASURES", {"passages_of_four_bar": lambda: 16.0})
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text("It passes 17\ntimes.")
    path = tmp_path / "docs/claims.toml"
    entry = '[[claim]]\npage = "README.md"\ntext = "{text}"\nkind = "{kind}"\nrange = [17, 17]\n'
    entry += 'measure = "passages_of_four_bar"\n'
    path.write_text(entry.format(text="passes 17 times", kind="accuracy"))
    assert main(["verify", "--claims", str(path)]) == 1
    assert "1 claim: 0 holds, 1 FAILS" in capsys.readouterr().out
    path.write_text(entry.format(text="passes 17 times", kind="speed"))
    assert main(["verify", "--claims", str(path), "--json", "-"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert [(claim["number"], claim["verdict"]) for claim in content["claims"]] == [(16.0, "differs")]
    assert main(["verify", "--claims", str(path), "--quick"]) == 2
    assert "--quick has no effect with --claims" in capsys.readouterr().err
    path.write_text(entry.format(text="passes 18 times", kind="accuracy"))
    (found,) = measure_claims(read_claims(path), tmp_path)
    assert found.verdict == claims.OUTDATED
    assert has_failed([found])
    assert claims.OUTDATED in as_text([found])


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ('kind = "beauty"\ncommand = "x"', "of the kind 'beauty'; allowed: accuracy, speed"),
        ('kind = "speed"', "must have a measure or a command"),
        ('kind = "speed"\nmeasure = "guess"', "the measure 'guess'; allowed: passages"),
        ('kind = "speed"\ncommand = "x"\nunit = "s"', "the key 'unit'; allowed: arguments"),
        ('kind = "speed"\ncommand = ""', "the command ''; allowed: a text"),
        ('kind = "speed"\ncommand = "x"\nrange = [1, 2]', "the key 'range', which needs a measure"),
        ('kind = "speed"\nmeasure = "passages_of_four_bar"\nrange = [1]', r"the range \[1\]; allowed: two numbers"),
        ('kind = "speed"\nmeasure = "passages_of_four_bar"\nrange = ["a", "b"]', "allowed: two numbers"),
        ('kind = "speed"\nmeasure = "passages_of_four_bar"\nrange = [nan, 1]', "allowed: two numbers"),
        ('kind = "speed"\nmeasure = "steps"\nrange = [1, 2]\narguments = ["ida"]', "a list of .'scene', 'solver'"),
    ],
)
def test_invalid_claims_are_errors(entry: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "claims.toml"
    path.write_text(f'[[claim]]\npage = "README.md"\ntext = "t"\n{entry}\n')
    with pytest.raises(UserError, match=message):
        read_claims(path)


@pytest.mark.parametrize("content", ["", "claim = 5", "claim = [5]", "[[claims]]", '[[claim]]\ntext = "t"'])
def test_a_list_without_claims_is_an_error(content: str, tmp_path: Path) -> None:
    path = tmp_path / "claims.toml"
    path.write_text(content)
    with pytest.raises(UserError, match=r"claims.toml' (contains no claim|has the (entry|page))"):
        read_claims(path)
