"""Which parameters are found responsible for what happens at values of several, and after how many trials."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from mbfmu.native.responsible import find_responsible

NAMES = [f"p{k}" for k in range(24)]


def found(wrong: Callable[[set[str]], bool]) -> tuple[list[str], str, int]:
    """Responsible parameters, the reason and the number of trials, where these moved parameters are wrong."""
    trials = []

    def tried(values: dict[str, float]) -> str:
        trials.append(values)
        return "it is so" if wrong({name for name, value in values.items() if value == 1.0}) else ""

    search: Any = SimpleNamespace(settable=NAMES, at_center=lambda: dict.fromkeys(NAMES, 0.0))
    names, reason = find_responsible(search, dict.fromkeys(NAMES, 1.0), "it is so", ["others"], tried)
    return names, reason, len(trials)


@pytest.mark.parametrize("guilty", [["p7"], ["p0", "p23"], ["p3", "p4", "p5"]])
def test_those_that_do_it_alone_are_found_by_halves(guilty: list[str]) -> None:
    names, reason, trials = found(lambda moved: not moved.isdisjoint(guilty))
    assert (names, reason) == (guilty, "it is so")
    assert trials <= 11 * len(guilty)  # of 24


def test_one_that_needs_another_is_found_one_by_one() -> None:
    """p1 is refused unless p20 moves, too; then p9 is."""
    names, _, _ = found(lambda moved: ("p1" in moved) != ("p20" in moved) or {"p1", "p9"} <= moved)
    assert "p1" in names


def test_two_that_do_it_together_are_both_named() -> None:
    names, reason, _ = found(lambda moved: {"p2", "p11"} <= moved)
    assert names == ["p2", "p11"]
    assert reason.startswith("with others")


def test_where_no_one_can_be_left_out_the_others_are() -> None:
    names, _, _ = found(lambda moved: len(moved) > 12)
    assert names == ["others"]
