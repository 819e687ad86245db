"""Reduction of finite element models: against the full model, closed forms, and other sizes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy
from fe_models import Block, block, bracket, straight

import mbfmu as mb
from mbfmu.mechanics.flexible.interfaces import rigid_motion
from mbfmu.util.errors import UserError

BLOCK, BRACKET = block(), bracket()
FACES = {"left": BLOCK.face(0, False), "right": BLOCK.face(0, True)}


def reduced(**options: Any) -> Any:
    return mb.FlexibleBody.from_fe(BLOCK.M, BLOCK.K, BLOCK.nodes, FACES, **options)


def rigid_ties(model: Any, dof: int, *sets: Any) -> np.ndarray:
    """Motions of all nodes by those of the free ones, and of rigid sets about their mean positions."""
    held = np.concatenate(sets)
    free = np.setdiff1d(np.arange(len(model.nodes)), held)
    columns = [np.eye(dof * len(model.nodes))[:, np.add.outer(dof * free, np.arange(dof)).ravel()]]
    for own in sets:
        motion = np.zeros((dof * len(model.nodes), 6))
        for node in own:
            motion[dof * node : dof * node + dof] = rigid_motion(model.nodes[node] - model.nodes[own].mean(axis=0), dof)
        columns.append(motion)
    return np.hstack(columns)


def frequencies(M: Any, K: Any, B: Any) -> Any:
    squares = scipy.linalg.eigh(B.T @ K @ B, B.T @ M @ B, eigvals_only=True)
    return np.sqrt(np.maximum(squares, 0.0))


def test_with_all_modes_the_frequencies_are_those_of_the_full_model_clamped_and_free() -> None:
    B = rigid_ties(BLOCK, 3, FACES["left"], FACES["right"])
    count = B.shape[1] - 12
    clamped = reduced(modes=count)
    np.testing.assert_allclose(
        clamped.frequencies, frequencies(BLOCK.M, BLOCK.K, np.delete(B, count + np.arange(6), 1)), rtol=1e-8
    )
    free = reduced(modes=count, frame="center")
    np.testing.assert_allclose(free.frequencies, frequencies(BLOCK.M, BLOCK.K, B)[6:], rtol=1e-8)


@pytest.mark.parametrize("frame", ["left", "center"])
def test_few_modes_give_the_lowest_frequencies_from_above(frame: str) -> None:
    B = rigid_ties(BLOCK, 3, FACES["left"], FACES["right"])
    full = frequencies(BLOCK.M, BLOCK.K, B)[6:] if frame == "center" else reduced(modes=B.shape[1] - 12).frequencies
    errors = []
    for modes in (6, 18):
        found = reduced(modes=modes, frame=frame).frequencies
        assert len(found) == modes + 6
        errors.append(found[:4] / full[:4] - 1.0)
        assert np.all(errors[-1] > -1e-9)
    assert errors[1].max() < 0.1 * errors[0].max() < 0.01


@pytest.mark.parametrize("tie", ["rigid", "average"])
def test_static_displacements_by_wrenches_on_an_interface_are_exact_without_any_mode(tie: str) -> None:
    """Against the full model; of an average tie with the equations of the mean motion as constraints."""
    faces = {"left": FACES["left"], "right": mb.Interface(nodes=FACES["right"], tie=tie)}
    body = mb.FlexibleBody.from_fe(BLOCK.M, BLOCK.K, BLOCK.nodes, faces, modes=0)
    n = 3 * len(BLOCK.nodes)
    motion = rigid_ties(BLOCK, 3, FACES["left"], FACES["right"])[:, -6:]
    if tie == "rigid":
        B = np.delete(rigid_ties(BLOCK, 3, FACES["left"], FACES["right"]), -12 + np.arange(6), 1)
        exact = np.linalg.inv(B.T @ BLOCK.K @ B)[-6:, -6:]
    else:
        held = np.add.outer(3 * FACES["left"], np.arange(3)).ravel()
        loads = np.linalg.pinv(motion).T  # work of a wrench on the mean motion
        free = np.setdiff1d(np.arange(n), held)
        exact = loads[free].T @ np.linalg.solve(BLOCK.K[np.ix_(free, free)], loads[free])
    kappa = body.modal_masses * body.frequencies**2
    Phi = body.interfaces["right"].motion
    np.testing.assert_allclose((Phi / kappa) @ Phi.T, exact, rtol=0, atol=1e-8 * np.abs(exact).max())


def test_mass_center_and_inertia_of_a_block_are_those_of_the_solid() -> None:
    body = reduced(modes=1)
    (a, b, c), m = (0.4, 0.1, 0.1), 1200.0 * 0.4 * 0.1 * 0.1
    assert body.mass == pytest.approx(m, rel=1e-12)
    np.testing.assert_allclose(body.com, [a / 2, 0.0, 0.0], atol=1e-12)  # from the center of the left face
    exact = m / 12.0 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    np.testing.assert_allclose(body.inertia, exact, atol=1e-12)


def test_sparse_matrices_and_many_degrees_of_freedom_give_the_same_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    dense = reduced(modes=5)
    monkeypatch.setattr("mbfmu.mechanics.flexible.reduction.MAX_DENSE", 10)
    M, K = scipy.sparse.csr_array(BLOCK.M), scipy.sparse.coo_matrix(BLOCK.K)
    sparse = mb.FlexibleBody.from_fe(M, K, BLOCK.nodes, FACES, modes=5)
    np.testing.assert_allclose(sparse.frequencies, dense.frequencies, rtol=1e-9)
    limited = mb.FlexibleBody.from_fe(
        M, K, BLOCK.nodes, FACES, frequency_limit=float(reduced(modes=5, frame="left").frequencies[-1])
    )
    assert limited.modes >= 6


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_another_size_scales_frequencies_masses_and_shapes(size: float) -> None:
    for make, dof, own in ((bracket, 6, {"foot": [0], "tip": [5]}), (block_of, 3, FACES)):
        one, other = make(1.0), make(size)
        a, b = (mb.FlexibleBody.from_fe(m.M, m.K, m.nodes, own, modes=3, frame="center") for m in (one, other))
        assert dof * len(one.nodes) == len(one.M)
        np.testing.assert_allclose(b.frequencies, a.frequencies / size, rtol=1e-7)
        np.testing.assert_allclose(b.mass, a.mass * size**3, rtol=1e-10)
        np.testing.assert_allclose(b._invariants.J2 / size**3, a._invariants.J2, atol=1e-7 * a.mass)


def block_of(size: float) -> Block:
    return Block((0.4 * size, 0.1 * size, 0.1 * size), (4, 1, 1), young=2e8, poisson=0.3, density=1200.0)


def test_coordinates_without_mass_are_condensed() -> None:
    """Lumped masses without moments of inertia."""
    lumped = np.diag(np.where(np.arange(len(BRACKET.M)) % 6 < 3, 0.05, 0.0))
    body = mb.FlexibleBody.from_fe(lumped, BRACKET.K, BRACKET.nodes, {"foot": [0], "tip": [5]}, modes=4)
    n = len(lumped)
    free = np.arange(6, n)
    inverse = scipy.linalg.eigh(lumped[np.ix_(free, free)], BRACKET.K[np.ix_(free, free)], eigvals_only=True)[::-1]
    np.testing.assert_allclose(body.frequencies[0], 1.0 / np.sqrt(inverse[0]), rtol=1e-3)


def changed(matrix: Any, i: int, j: int, by: float) -> Any:
    other = matrix.copy()
    other[i, j] += by * np.abs(matrix).max()
    return other


def test_models_that_are_wrong_are_refused_by_what_is_wrong() -> None:
    M, K, X = BLOCK.M, BLOCK.K, BLOCK.nodes
    cases: list[tuple[Any, ...]] = [
        ((M, changed(K, 3, 7, 0.1), X, FACES), {}, r"stiffness matrix is not symmetric: entries \((3, 7|7, 3)\)"),
        ((M, K[:-3, :-3], X, FACES), {}, "60 rows and stiffness matrix 57"),
        ((M[:-3, :-3], K[:-3, :-3], X, FACES), {}, "3 or 6 degrees of freedom a node"),
        ((-M, K, X, FACES), {}, "mass matrix is indefinite"),
        ((M, changed(K, 0, 0, 0.5), X, FACES), {}, "resists rigid-body motions"),
        ((M, 0 * K, X, FACES), {}, "stiffness matrix is zero"),
        ((M, K * np.nan, X, FACES), {}, "stiffness matrix contains numbers that are not finite"),
        ((M, changed(K, 3, 3, 1e290), X, FACES), {}, r"stiffness matrix contains .*e\+29.; allowed: numbers up to"),
        ((changed(M, 4, 4, 1e300), K, X, FACES), {}, r"mass matrix contains .*; allowed: numbers up to 1e\+150"),
        ((M, K, X, {}), {}, "needs at least one"),
        ((M, K, X, {"left": []}), {}, "interface 'left' has no node"),
        ((M, K, X, {"left": [0]}), {}, "'left' has 1 node, .* at least three"),
        ((M, K, X, {"left": [0, 4, 8]}), {}, "'left' has 3 nodes on a line"),
        ((M, K, X, {"left": [0, 1, 99]}), {}, "node 99, but there are 20"),
        ((M, K, X, {"left": FACES["left"], "top": [0, 1, 10]}), {}, "node 0 belongs to interfaces 'left' and 'top'"),
        ((M, K, X, FACES), {"frame": "middle"}, "frame is 'middle'; allowed: 'left', 'right', 'center'"),
        ((M, K, X, FACES), {"modes": 1000}, "modes is 1000; the model has 36"),
        ((M, K, X, {"left": FACES["left"]}), {"modes": 0}, "has no mode"),
        ((M, K, X, FACES), {"modes": 2, "frequency_limit": 100.0}, "allowed: one of them"),
        ((M, K, X, FACES), {"damping": -0.1}, "damping of a flexible body is -0.1"),
        ((M, K, X, FACES), {"frame": "center", "geometric_stiffness": lambda u: K}, "'center' with geometric"),
        ((M, K, X, FACES), {"geometric_stiffness": lambda u: K[:3]}, "geometric_stiffness returns"),
    ]
    for arguments, options, message in cases:
        with pytest.raises(UserError, match=message):
            mb.FlexibleBody.from_fe(*arguments, **options)
    loose = np.vstack([X, [[9.0, 9.0, 9.0]]])
    grown = [np.pad(A, (0, 3)) for A in (M, K)]
    with pytest.raises(UserError, match="node 20 has neither mass nor stiffness"):
        mb.FlexibleBody.from_fe(*grown, loose, FACES)


@pytest.mark.parametrize("spring", [0.02, 1.0, 50.0])
def test_weak_springs_to_the_ground_are_refused(spring: float) -> None:
    """In units of the stiffness of the tip, 3 E I / L^3; single nodes resist with up to 1e6 times as much."""
    beam = straight(1.0, 20, slender=1e4)
    held = np.array(beam.K)
    held[121, 121] += spring * 3.0  # along y at the tip
    ends = {"root": [0], "tip": [20]}
    assert mb.FlexibleBody.from_fe(beam.M, beam.K, beam.nodes, ends, modes=2).modes == 8
    with pytest.raises(UserError, match="resists rigid-body motions"):
        mb.FlexibleBody.from_fe(beam.M, held, beam.nodes, ends, modes=2)


def test_parts_that_are_not_joined_are_refused() -> None:
    beam = straight(1.0, 4)
    M, K = (scipy.linalg.block_diag(A, A) for A in (beam.M, beam.K))
    nodes = np.vstack([beam.nodes, beam.nodes + np.array([0.0, 1.0, 0.0])])
    with pytest.raises(UserError, match="Parts of the body may not be joined"):
        mb.FlexibleBody.from_fe(M, K, nodes, {"a": [0], "b": [9]}, modes=4)


def test_mass_matrices_with_missing_entries_are_refused() -> None:
    """Entries between displacements and rotations do not change the mass, but the first moments."""
    ends: dict[str, Any] = {"foot": [0], "tip": [5]}
    coupled = [(i, j) for i, j in np.argwhere(np.abs(BRACKET.M) > 2e-3) if i % 6 < 3 <= j % 6]
    assert len(coupled) > 10
    for i, j in coupled:
        M = BRACKET.M.copy()
        M[i, j] = M[j, i] = 0.0
        with pytest.raises(UserError, match=r"first moments that differ by .* Check that all its entries are given"):
            mb.FlexibleBody.from_fe(M, BRACKET.K, BRACKET.nodes, ends, modes=4)


def test_lumped_masses_without_rotational_inertia_are_reported_as_such() -> None:
    beam = straight(1.0, 4)
    M = np.kron(np.eye(5), np.diag([0.2, 0.2, 0.2, 0.0, 0.0, 0.0]))
    with pytest.raises(UserError, match="give fewer modes, and inertias to nodes that rotate"):
        mb.FlexibleBody.from_fe(M, beam.K, beam.nodes, {"a": [0], "b": [4]}, modes=2)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda K: K, "geometric_stiffness is a ndarray; allowed: a function"),
        (lambda K: lambda u: np.triu(K) * u.sum(), "not symmetric"),
        (lambda K: lambda u: K * float(u @ u), "not linear"),
    ],
)
def test_geometric_stiffness_is_a_linear_function_with_symmetric_values(given: Any, message: str) -> None:
    beam = straight(1.0, 4)
    with pytest.raises(UserError, match=message):
        mb.FlexibleBody.from_fe(
            beam.M, beam.K, beam.nodes, {"a": [0], "b": [4]}, modes=2, geometric_stiffness=given(beam.K)
        )


def test_positions_in_millimeters_are_found() -> None:
    with pytest.raises(UserError, match="not if their positions are in mm"):
        mb.FlexibleBody.from_fe(BRACKET.M, BRACKET.K, 1e3 * BRACKET.nodes, {"foot": [0], "tip": [5]})
    with pytest.warns(UserWarning, match=r"faster than in any material.*\[implausible-units\]"):
        mb.FlexibleBody.from_fe(BLOCK.M, BLOCK.K, 1e3 * BLOCK.nodes, FACES)
