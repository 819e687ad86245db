"""Errors of ``esdirk`` in meshes are those of nodes: steps depend on the motion, not on the distance of the nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from fmus.sheet import Sheet
from solvers import Options, stepper
from solvers.compiled.kernel import COMPILED, kernel
from solvers.projection.saddle import Accelerations

pytestmark = pytest.mark.skipif(not COMPILED, reason="takes minutes without a compiler")

END = 0.05  # s


@kernel
def call_mesh_motion(function: Any, dq: Any, mask: Any, data: Any, out: Any) -> None:
    function(dq, mask, data, out)


@pytest.mark.parametrize(
    "sheet",
    [
        Sheet(nx=8, nz=7, tree="spine"),
        Sheet(nx=8, nz=7, tree="rows", membrane=True),
        Sheet(nx=8, nz=7, stretch=True),
        Sheet(nx=8, nz=7, support="free"),
    ],
    ids=["spine", "rows", "stretch", "free"],
)
def test_motion_of_nodes_is_the_difference_of_their_positions(sheet: Sheet) -> None:
    compiled = sheet.compile()
    system, (q, v) = compiled.system, compiled.assemble()
    rng, step = np.random.default_rng(3), 1e-6
    dq, rest = rng.normal(size=system.n), np.zeros(system.n)
    system.apply(q, 0.05 * rng.normal(size=system.n))
    nodes = np.array([body.index for mesh in compiled.mechanism.meshes for row in mesh.nodes for body in row])
    joined = [i for i in nodes if compiled.data.arrays.bodies[i]["parent"] in nodes]

    def places(distance: float) -> tuple[Any, Any]:
        moved = q.copy()
        system.apply(moved, distance * dq)
        system.residual(0.0, moved, v, rest)
        bodies = compiled.data.state.bodies
        return bodies["r"][joined].copy(), bodies["A"][joined].copy()

    (r1, A1), (r0, A0) = places(step), places(-step)
    displacements = np.linalg.norm(r1 - r0, axis=1) / (2.0 * step)
    rotations = Rotation.from_matrix(A1 @ A0.transpose(0, 2, 1)).magnitude() / (2.0 * step)
    out, mask = np.zeros(2), np.asarray(system.mesh_mask, float)
    system.residual(0.0, q, v, rest)
    call_mesh_motion(system.mesh_motion, dq, mask, system.pinned_data, out)
    assert out == pytest.approx([displacements.max(), rotations.max()], rel=1e-7)


def places_of_nodes(compiled: Any, q: Any) -> Any:
    """Return the positions (nodes, 3) at q."""
    system = compiled.system
    system.residual(0.0, q, np.zeros(system.n), np.zeros(system.n))
    nodes = [body.index for mesh in compiled.mechanism.meshes for row in mesh.nodes for body in row]
    return compiled.data.state.bodies["r"][nodes].copy()


@pytest.mark.parametrize("damping", [0.0, 2e-3])
@pytest.mark.parametrize("grid", [(7, 5), (9, 7)])
def test_nodes_are_within_the_tolerance(grid: tuple[int, int], damping: float) -> None:
    """Of their motion by DOP853, in units of the length of the sheet."""
    sheet = Sheet(nx=grid[0], nz=grid[1], damping=damping)
    compiled = sheet.compile()
    system, (q, v) = compiled.system, compiled.assemble()
    accelerations = Accelerations(system)

    def right(t: float, y: Any) -> Any:
        accelerations.solve(t, y[: system.nq], y[system.nq :])
        return np.concatenate((accelerations.qdot, accelerations.a))

    true = solve_ivp(right, (0.0, END), np.concatenate((q, v)), method="DOP853", rtol=1e-8, atol=1e-10)
    expected = places_of_nodes(compiled, true.y[: system.nq, -1])
    errors = []
    for tolerance in (1e-3, 1e-4, 1e-5):
        run = stepper("esdirk", system, 0.0, *compiled.assemble(), Options(rtol=tolerance))
        assert run.advance(END).ok
        distance = np.linalg.norm(places_of_nodes(compiled, run.q) - expected, axis=1).max()
        errors.append(distance / sheet.length / tolerance)
    assert max(errors) < 1.5, errors


@pytest.mark.parametrize("damping", [0.0, 2e-3])
def test_finer_grids_take_as_many_steps(damping: float) -> None:
    steps = []
    for nx, nz in ((11, 8), (21, 15), (41, 29)):
        compiled = Sheet(nx=nx, nz=nz, damping=damping, membrane=True).compile()
        run = stepper("esdirk", compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-4))
        assert run.advance(3.0 * END).ok
        steps.append(run.statistics.steps)
    assert max(steps) <= 1.3 * min(steps), steps
