"""Studies of a sheet in nips: solvers that do not suit contact are reported once and not run; there is no rest."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

import mbfmu as mb
from fmus.feeder import Feeder
from mbfmu.mechanics import Mechanism
from mbfmu.modeling.scene import Scene, default_scene
from mbfmu.sheets import add_sheet
from mbfmu.studies.compare import compare
from mbfmu.studies.reference import tight_runs
from mbfmu.util.errors import EquilibriumError, UserError
from solvers.steppers import describe_refusal

SMALL: dict[str, Any] = {"solvers": None, "tolerances": [1e-3], "repeats": 1, "outputs": ["lead.x"]}
FREE: dict[str, Any] = {"path": "straight", "nips": 1, "guides": False}
ADAMS = "solver 'adams' is explicit, but the contact stiffness of nips"


def scene(nx: int = 5) -> Scene:
    return replace(default_scene(Feeder(**FREE, nx=nx, nz=4)), stop_time=0.01, output_interval=0.002)


def test_solvers_that_do_not_suit_contact_are_omitted_with_a_message() -> None:
    found = compare(scene(), resolutions=[{}], **SMALL)
    assert {row.solver for row in found.rows} == {"esdirk", "ida"}
    assert all(row.trusted and row.error is not None and row.error < 1e-2 for row in found.rows)
    assert found.reference.motion.source == "esdirk at 1e-4"
    adams, unexamined = map(str, found.diagnostics)
    assert "'gravity.y'" in unexamined
    assert adams.startswith(f"omitted: {ADAMS}")
    assert adams.lower().endswith("use 'ida' or 'esdirk' [unsuitable-solver]")


def test_what_suits_one_grid_need_not_suit_another() -> None:
    """On 4 x 4 nodes there are matrices, and radau; on 5 x 4 there are not."""
    found = compare(scene(), resolutions=[{"nx": 4}, {"nx": 5}], **SMALL)
    large = {("ida", 5), ("esdirk", 5)}
    assert {(row.solver, row.resolution["nx"]) for row in found.rows} == {("ida", 4), ("radau", 4), *large}
    assert [d.code for d in found.diagnostics] == ["unsuitable-solver", "not-examined"]
    assert found.diagnostics[0].text.startswith("omitted: solver 'adams' is explicit")


def test_a_choice_of_solvers_none_of_which_suits_is_refused() -> None:
    with pytest.raises(UserError, match=f"^nothing can be compared: {ADAMS}"):
        compare(scene(), resolutions=[{}], **(SMALL | {"solvers": ["adams"]}))
    with pytest.raises(UserError, match=f"^nothing can be compared: {ADAMS}"):
        mb.recommend_solver(scene(), 1e-2, resolutions=[{}], solvers=["adams"])


def test_a_target_is_answered_by_what_suits() -> None:
    found = mb.recommend_solver(scene(), "1 mm", resolutions=[{}], outputs=["lead.x"])
    assert found.row.solver in {"esdirk", "ida"}
    assert found.sentence.startswith(f"recommended: solver {found.row.solver}, tolerance ")
    assert any(ADAMS in d.text for d in found.diagnostics)


def test_sheets_without_contact_are_compared_as_they_were() -> None:
    m = Mechanism()
    kind: dict[str, Any] = {"thickness": 1e-4, "youngs_modulus": 4e9, "density": 800.0, "tree": "master"}
    add_sheet(m, "sheet", length=0.3, width=0.2, grid=(7, 5), **kind)
    compiled = mb.mechanics.CompiledMechanism(m)
    assert not any(describe_refusal(name, compiled.system) for name in ("ida", "adams", "hybrid", "esdirk"))
    runs = tight_runs(compiled, 1e-4)
    assert runs[0] == (("adams", 1e-9), ("adams", 1e-8))
    assert [pair[1][0] for pair in runs[1:]] == ["ida"] * (len(runs) - 1)


def test_a_sheet_without_support_has_no_equilibrium_and_is_refused() -> None:
    with pytest.raises(
        EquilibriumError, match=r"^no equilibrium was found .* friction of contacts is proportional to slip"
    ):
        mb.equilibrium(Feeder(path="straight", nips=1, nx=5, nz=4, speed=0.0, guides=False))
