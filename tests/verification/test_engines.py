"""Mass matrices and accelerations of random trees, against MuJoCo, and Pinocchio where it is installed."""

from __future__ import annotations

from typing import Any

import pytest

from mbfmu.cli import main
from mbfmu.verification.engines import with_mbfmu
from mbfmu.verification.engines.compare import compare_engines, installed_engines
from mbfmu.verification.engines.random_trees import POSITIONS, Dynamics, random_tree

COUNT = 25


@pytest.mark.skipif(not installed_engines(), reason="no other engine is installed")
def test_random_trees_have_the_dynamics_of_other_engines() -> None:
    kinds = {link.joint for seed in range(COUNT) for link in random_tree(seed)[0]}
    assert kinds == set(POSITIONS)
    for found in compare_engines(COUNT):
        assert found.worst < 1.0, found


@pytest.mark.skipif(not installed_engines(), reason="no other engine is installed")
@pytest.mark.parametrize("part", ["mass_matrix", "acceleration"])
def test_a_small_difference_is_found(
    part: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    evaluate = with_mbfmu.evaluate

    def wrong(*given: Any) -> Dynamics:
        found = evaluate(*given)
        return found._replace(**{part: getattr(found, part) * (1.0 + 1e-6)})

    monkeypatch.setattr(with_mbfmu, "evaluate", wrong)
    assert main(["verify", "--engines", "3"]) == 1
    assert "WRONG" in capsys.readouterr().out
