"""Large mechanisms with loops when they are built: closed positions, velocities and redundant equations by NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mechanisms import ladder, n_four_bar

from mbfmu.mechanics import CompiledMechanism, Mechanism, Revolute, RevoluteCutJoint, rod
from mbfmu.mechanics.arrays import redundant
from mbfmu.util.errors import AssemblyError


def matrices(compiled: CompiledMechanism, t: float, q: Any) -> Any:
    """The terms of the equations at rest, by matrices."""
    dense = compiled.system.dense()
    terms = dense.allocate_terms()
    dense.fill(t, q, np.zeros(dense.n), terms)
    return terms


def doubled(loops: int, *, off: float = 0.0) -> Mechanism:
    """A row of four-bars whose columns 5, 10, ... have a second pivot; ``off`` (m): this one is shifted."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    column, top = m.body("column0", m.ground, Revolute(start=1.5), **rod(mass=1.0, length=1.0)), (1.0, 0.0, 0.0)
    for i in range(1, loops + 1):
        coupler = m.body(f"coupler{i}", column, Revolute(at=top, start=-1.5), **rod(mass=1.0, length=1.0))
        hinge = Revolute(at=(1.0, 0.0, 0.0), start=1.5)
        column = m.body(f"column{i}", coupler, hinge, **rod(mass=1.0, length=-1.0))
        for k in range(2 if i % 5 == 0 else 1):
            foot = {"at_a": (-1.0, 0.0, 0.0), "at_b": (i + k * off, 0.0, 0.0)}
            m.cut(f"foot{i}.{k}", RevoluteCutJoint(**foot), column, m.ground)
        top = (0.0, 0.0, 0.0)
    return m


@pytest.mark.parametrize("make", [lambda: n_four_bar(60), lambda: n_four_bar(60, grounded=True), lambda: ladder(40)])
def test_loops_close_by_the_least_changes(make: Any) -> None:
    compiled, rng = CompiledMechanism(make().mechanism), np.random.default_rng(3)
    system, held = compiled.system, np.zeros(compiled.system.n, bool)
    assert not system.has_matrices
    held[0] = True
    start = compiled.assembly.start_positions() + 1e-3 * rng.normal(size=system.n)
    q, best = compiled.assembly.close(0.0, start, held), start.copy()
    for _ in range(30):  # Gauss-Newton
        T = matrices(compiled, 0.0, best)
        best[~held] -= np.linalg.pinv(T.J[:, ~held]) @ T.Phi
    assert np.abs(matrices(compiled, 0.0, q).Phi).max() < 1e-11 * compiled.length
    np.testing.assert_allclose(q, best, atol=1e-9)


def test_velocities_are_the_nearest_consistent_ones() -> None:
    compiled = CompiledMechanism(n_four_bar(60).mechanism)
    q, v = compiled.assembly.assemble(0.0)
    J = matrices(compiled, 0.0, q).J
    motion = np.array([1.0, *(-1.0, 1.0) * 60])
    np.testing.assert_allclose(J @ motion, 0.0, atol=1e-12)
    np.testing.assert_allclose(v, -motion, atol=1e-9)  # the first column is held at its rate


def test_a_long_row_of_loops_has_no_redundant_equation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its J has a full rank, but the smallest singular value decreases with the number of loops."""
    monkeypatch.setattr(redundant.Redundancy, "find", lambda *_: pytest.fail("searched by matrices"))
    compiled = CompiledMechanism(n_four_bar(400).mechanism)
    q, _ = compiled.assembly.assemble(0.0)
    notes = compiled.assembly.notes(0.0, q)
    assert {note.code for note in notes} == {"removed-constraints"}
    assert not compiled.explain_lock(0.0, q, 1)


def test_redundant_equations_are_those_without_which_the_rank_is_the_same() -> None:
    compiled = CompiledMechanism(doubled(60))
    q, _ = compiled.assembly.assemble(0.0)
    found = compiled.assembly.find_redundant(0.0, q)
    J = matrices(compiled, 0.0, q).J
    assert np.linalg.matrix_rank(J, tol=1e-8) == len(J) - 24 == len(J) - len(found)
    assert np.linalg.matrix_rank(np.delete(J, found, axis=0), tol=1e-8) == len(J) - 24
    names = [compiled.system.constraint_names[i] for i in found]
    assert {name.partition(".")[0] for name in names} <= {f"foot{i}" for i in range(61)}


def test_a_second_pivot_that_does_not_fit_is_refused() -> None:
    compiled = CompiledMechanism(doubled(60, off=0.01))
    with pytest.raises(AssemblyError, match="loop cannot close"):
        compiled.assemble(0.0)


def test_a_singular_start_is_reported() -> None:
    m = n_four_bar(60).mechanism
    compiled = CompiledMechanism(m)
    q = np.zeros(compiled.system.n)
    notes = {note.code for note in compiled.assembly.notes(0.0, q)}
    assert "singular-start" in notes
