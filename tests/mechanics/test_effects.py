"""The power balance of every effect of a sheet: what acts on it changes its energy by that power, and no other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from plate_oracles import acm_stiffness, isotropic
from random_mechanisms import Case
from test_identities import close, derivative, observed

from mbfmu.mechanics import CompiledMechanism, Harmonic, Mechanism, Translational
from mbfmu.mechanics.recursions.aba import forward_dynamics
from mbfmu.mechanics.recursions.dynamics import update_kinematics
from mbfmu.sheets import Crease, Sheet, Support, add_sheet

TREES = ["spine", "rows", "master"]
GRAVITY = np.array([0.4, -0.9, 0.6])
LENGTH, WIDTH, THICKNESS, MODULUS, NU = 3.0, 2.0, 0.3, 10.0, 0.3
A, B = LENGTH / 3, WIDTH / 2
SOFT = {"length": LENGTH, "width": WIDTH, "thickness": THICKNESS, "youngs_modulus": MODULUS, "poisson": NU}
BENDING = acm_stiffness(A, B, isotropic(MODULUS * THICKNESS**3 / (12.0 * (1.0 - NU**2)), NU))
ON: dict[str, dict[str, Any]] = {
    "bending": {},
    "gravity": {"gravity": GRAVITY},
    "membrane": {"membrane": True},
    "all strains": {"membrane": "xzs"},
    "damping": {"damping": 0.2},
    "damped membrane": {"membrane": True, "damping": 0.2},
    "drag": {"drag": 0.6},
    "edge": {"moved": True},
    "grain": {"youngs_modulus": (10.0, 6.0), "angle": 0.5, "membrane": True},
    "curl": {"curl": (0.3, -0.2, 0.1), "membrane": True, "damping": 0.2},
    "crease": {"creases": [Crease("x", 1.2, 0.1)]},
}
EVERYTHING: dict[str, Any] = {"gravity": GRAVITY, "membrane": "xzs", "damping": 0.2, "drag": 0.6, "moved": True}


def shaken(tree: str, *, gravity: Any = (0.0, 0.0, 0.0), moved: bool = False, **effects: Any) -> tuple[Case, Sheet]:
    """A sheet whose numbers are of the order of one, in a random state.

    ``moved``: drives carry its edge, or its master node, along two axes.
    """
    m = Mechanism(gravity=gravity)
    stand = m.ground
    if moved:
        drives = Harmonic(amplitude=0.5, frequency=0.3, phase=0.4), Harmonic(amplitude=0.3, frequency=0.5, mean=0.1)
        for axis, drive in zip("xy", drives, strict=True):
            stand = m.body(f"stand_{axis}", stand, Translational(axis=axis, drive=drive))
            m.output(f"effort_{axis}", stand.effort())
            m.output(f"rate_{axis}", stand.rate())
    held: dict[str, Any] = {"supports": [Support("x1", body=stand)]}
    if tree == "master":
        held = {"master": stand if moved else None}
    sheet = add_sheet(m, "sheet", density=1.0, grid=(4, 3), tree=tree, **held, **(SOFT | effects))
    compiled, rng = CompiledMechanism(m), np.random.default_rng(2)
    q, n = compiled.assembly.start_positions(), compiled.system.n
    compiled.system.apply(q, 0.2 * rng.normal(size=n))
    return Case(compiled, 0.3, q, 0.5 * rng.normal(size=n), rng.normal(size=n)), sheet


def corners_of(case: Case, sheet: Sheet, t: float, q: Any, v: Any) -> list[tuple[Any, Any, Any]]:
    """Origins, normals and velocities (4, 3) of the corners of every element."""
    update_kinematics(t, q, v, *case.compiled.kernel_data)
    bodies, (nx, nz) = case.compiled.data.state.bodies, (len(sheet.nodes), len(sheet.nodes[0]))
    found = []
    for i in range(nx - 1):
        for k in range(nz - 1):
            nodes = [sheet.node(*n).index for n in ((i, k), (i + 1, k), (i + 1, k + 1), (i, k + 1))]
            found.append((bodies["r"][nodes], bodies["A"][nodes, :, 1], bodies["Y"][nodes, :3]))
    return found


def deformation(r: Any, normals: Any) -> Any:
    """Deflections and slopes of an element's corners in its own axes (12,), then E_xx, E_zz and gamma."""
    g1, g2 = 0.5 * (r[1] - r[0] + r[2] - r[3]), 0.5 * (r[3] - r[0] + r[2] - r[1])
    x, y = g1 / np.linalg.norm(g1), np.cross(g2, g1) / np.linalg.norm(np.cross(g2, g1))
    z = np.cross(x, y)
    lean = np.arccos(normals @ y)
    w = -np.array([normals @ x, normals @ z]) * lean / np.sin(lean)
    u = np.array([(r - r.mean(axis=0)) @ y, *w]).T

    def along(edges: Any, slope: Any, g: Any, length: float) -> float:
        """Mean over two edges: chords by g and what is off the plane, half the mean square slope of their cubics."""
        total = 0.0
        for start, end in edges:
            rise = u[end, 0] - u[start, 0]
            s, e = slope[start] - rise / length, slope[end] - rise / length
            total += 0.25 * ((g @ g + rise**2) / length**2 - 1.0) + (2.0 * s * s - s * e + 2.0 * e * e) / 60.0
        return float(total)

    strains = [
        along([(0, 1), (3, 2)], w[0], g1, A),
        along([(0, 3), (1, 2)], w[1], g2, B),
        g1 @ g2 / (A * B),
    ]
    return np.concatenate((u.reshape(-1), strains))


def stiffness(strains: str) -> Any:
    """Constant stiffness (15, 15) by :func:`deformation`: bending, and plane stress where strains are resisted."""
    K = np.zeros((15, 15))
    K[:12, :12] = BENDING
    if "x" in strains and "z" in strains:
        K[12:14, 12:14] = np.array([[1.0, NU], [NU, 1.0]]) / (1.0 - NU**2)
    else:
        K[12, 12], K[13, 13] = "x" in strains, "z" in strains
    K[14, 14] = ("s" in strains) / (2.0 * (1.0 + NU))
    K[12:, 12:] *= MODULUS * THICKNESS * A * B
    return K


def dissipated(case: Case, sheet: Sheet) -> tuple[float, float]:
    """Power that damping and drag take by their closed forms: beta e'.K e', and rho c A |v_n|^3 / 2, over elements."""
    rates = derivative(
        case, lambda t, q, v: np.array([deformation(r, d) for r, d, _ in corners_of(case, sheet, t, q, v)])
    )
    K = stiffness(sheet.plate.strains)
    damping = sheet.plate.damping * sum(e @ K @ e for e in rates)
    drag = 0.0
    for r, _, Y in corners_of(case, sheet, case.t, case.q, case.v):
        normal = np.cross(r[2] - r[0], r[1] - r[3])
        speed = Y.mean(axis=0) @ normal / np.linalg.norm(normal)
        drag += 0.5 * sheet.plate.drag * A * B * abs(speed) ** 3
    return damping, drag


def powers(case: Case) -> tuple[float, float]:
    """What would have to act on the free coordinates at accelerations a, and the drives' efforts: their powers."""
    terms = case.compiled.system.allocate_terms()
    case.compiled.system.fill(case.t, case.q, case.v, terms)
    seen = observed(case, case.t, case.q, case.v, case.a, np.zeros(0))
    drives = sum(seen[f"effort_{axis}"] * seen[f"rate_{axis}"] for axis in "xy" if seen)
    return float((terms.M @ case.a + terms.h) @ case.v), drives


@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("effects", [*ON.values(), EVERYTHING], ids=[*ON, "everything"])
def test_energy_changes_by_the_power_of_forces_and_drives_less_what_is_dissipated(
    effects: dict[str, Any], tree: str
) -> None:
    """With inverse dynamics at any accelerations."""
    case, sheet = shaken(tree, **effects)
    (acting, driving), taken = powers(case), dissipated(case, sheet)
    assert (driving != 0.0, taken[0] > 0.0, taken[1] > 0.0) == tuple(
        key in effects for key in ("moved", "damping", "drag")
    )
    close(derivative(case, case.compiled.energy), acting + driving - sum(taken))


@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("effects", [*ON.values(), EVERYTHING], ids=[*ON, "everything"])
def test_left_alone_it_gains_what_drives_give_and_loses_what_is_dissipated(effects: dict[str, Any], tree: str) -> None:
    """With forward dynamics."""
    case, sheet = shaken(tree, **effects)
    update_kinematics(case.t, case.q, case.v, *case.compiled.kernel_data)
    assert forward_dynamics(*case.compiled.kernel_data) == 0
    full, free = case.compiled.data.state.a, case.compiled.data.arrays.bodies
    case.a = np.concatenate([full[b["vi"] : b["vi"] + b["nv"]] for b in free if b["vf"] >= 0])
    driving = powers(case)[1]
    close(derivative(case, case.compiled.energy), driving - sum(dissipated(case, sheet)))


@pytest.mark.parametrize("effect", [key for key in ON if key != "bending"])
def test_each_effect_has_a_separate_power(effect: str) -> None:
    """On against off in one state: without this the balance would hold of an effect that does nothing."""
    on, off = shaken("spine", **ON[effect])[0], shaken("spine")[0]
    assert abs(sum(powers(on)) - sum(powers(off))) > 1e-3
