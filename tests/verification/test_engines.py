"""Mass matrices and accelerations of random trees, against MuJoCo, and Pinocchio where it is installed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.cli import main
from mbfmu.verification.engines import loops, motions, with_mbfmu
from mbfmu.verification.engines.compare import compare_engines, installed_engines
from mbfmu.verification.engines.random_trees import POSITIONS, Dynamics, random_tree, start_of

COUNT = 25
MOVED = 21  # seed of the tree that is simulated


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
    monkeypatch.setattr(motions, "compare_motions", lambda *_: [])
    assert main(["verify", "--engines", "3"]) == 1
    assert "WRONG" in capsys.readouterr().out


@pytest.mark.skipif("pinocchio" not in installed_engines(), reason="Pinocchio is not installed")
def test_random_loops_have_the_accelerations_of_pinocchio(monkeypatch: pytest.MonkeyPatch) -> None:
    found = loops.compare_random_loops(COUNT)
    assert found.count > 5
    assert found.is_right, found
    build = with_mbfmu.build
    monkeypatch.setattr(with_mbfmu, "build", lambda links, gravity: build(links, gravity * (1.0 + 1e-6)))
    assert not loops.compare_random_loops(COUNT).is_right


@pytest.mark.parametrize("package", installed_engines())
def test_a_random_tree_moves_as_in_another_engine(package: str) -> None:
    assert {link.joint for link in random_tree(MOVED)[0]} == {"cylindrical", "spherical", "translational", "universal"}
    lines = motions.compare_motions(MOVED, package)
    assert {line.verdict for line in lines} == {"right"}
    assert {line.method for line in lines} >= {"adams", "radau", "ida"}


@pytest.mark.parametrize("package", installed_engines()[:1])
def test_a_motion_that_differs_is_wrong(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    build = motions.build
    monkeypatch.setattr(motions, "build", lambda links, gravity: build(links, gravity * (1.0 + 1e-3)))
    assert {line.verdict for line in motions.compare_motions(MOVED, package)} == {"WRONG"}


def test_centers_of_mass_of_a_tree_are_those_of_the_mechanism() -> None:
    for seed in range(5):
        links, gravity = random_tree(seed)
        m = motions.build(links, gravity)
        found = mb.Simulation(m, mb.Settings(solver="adams")).outputs()[: 3 * len(links)]
        np.testing.assert_allclose(found, motions.centers(links, start_of(links)[0]), atol=1e-12)
