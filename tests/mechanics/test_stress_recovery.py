"""Stress recovery of plates and shells: polynomials against stiffness, sheets against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import Mechanism, PointForce, Weld
from mbfmu.sheets import Plate, Shell, Support, add_sheet
from mbfmu.sheets.elements.material import PlaneStress
from mbfmu.sheets.elements.plate_curvature import curvature
from mbfmu.sheets.elements.shell_stiffness import GAUSS_POINTS

L, W, T, E, NU, RHO = 0.3, 0.2, 0.5e-3, 1e10, 0.3, 1000.0
A = PlaneStress(E, NU).Q * T
D = A * T**2 / 12.0
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(4)
MODELS: dict[str, dict[str, Any]] = {"plate": {"membrane": True}, "shell": {"stretch": True}}


class Anywhere:
    """Where a plate is whose record is looked at."""

    bodies = (1, 2, 3, 4)

    def scratch(self, dtype: Any) -> int:
        return 0


def sheet(gravity: Any, **options: Any) -> tuple[Mechanism, Any]:
    """A sheet clamped at x = 0."""
    m = Mechanism(gravity=gravity)
    given = {"length": L, "width": W, "thickness": T, "youngs_modulus": E, "poisson": NU, "density": RHO}
    return m, add_sheet(m, "sheet", grid=(11, 7), supports=[Support("x0")], **(given | options))


def test_curvatures_of_the_rectangle_store_its_energy() -> None:
    a, b = 0.7, 0.4
    plate = Plate(a=a, b=b, thickness=T, youngs_modulus=E, poisson=NU)
    record = np.zeros(1, Plate.record)[0]
    plate.fill(record, Anywhere())  # type: ignore[arg-type]
    K = np.diag(record["bending"])
    for i in range(0, 8, 2):
        K[i, i + 1] = K[i + 1, i] = record["coupling"]
    found = np.zeros((9, 9))
    for x, wx in zip(POINTS, WEIGHTS, strict=True):
        for z, wz in zip(POINTS, WEIGHTS, strict=True):
            B = curvature(a, b, 0.5 * a * (1.0 + x), 0.5 * b * (1.0 + z))
            found += 0.25 * a * b * wx * wz * B.T @ D @ B
    np.testing.assert_allclose(found, K, atol=1e-13 * K.max())


def test_forces_of_a_shell_are_derivatives_of_its_energy() -> None:
    """Forces times strains over a rectangle are the energy but for that of the turns, moments times curvatures all."""
    a, b = 0.7, 0.4
    shell = Shell(corners=[[0, 0, 0], [a, 0, 0], [a, 0, b], [0, 0, b]], stretching=A, bending=D)
    record = np.zeros(1, Shell.record)[0]
    shell.fill(record, Anywhere())  # type: ignore[arg-type]
    d = np.random.default_rng(0).normal(size=(4, 6))
    energy = {"force": 0.0, "moment": 0.0}
    double = np.array([1.0, 1.0, 2.0])  # the tensors' components xz count twice
    for x, z in 0.5 * (1.0 + GAUSS_POINTS):
        recovered = {key: np.tensordot(value.weights, d, 2) for key, value in shell.recover(x, z).items()}
        for force, strain in (("force", "strain"), ("moment", "curvature")):
            energy[force] += 0.25 * a * b * (double * recovered[force]) @ recovered[strain]
    bent, plane = d[:, 1::2].reshape(-1), d[:, 0::2].copy()
    assert energy["moment"] == pytest.approx(bent @ record["bent"] @ bent, rel=1e-12)
    plane[:, 2] = 0.0
    K = record["plane"].reshape(4, 3, 4, 3)
    turns = K[:, 2, :, 2]  # of the slight spring alone, (a mean of turns) times 2 about a rectangle
    assert np.abs(turns).max() < 1e-2 * np.abs(K[:, :2, :, :2]).max()
    whole = plane.reshape(-1) @ record["plane"] @ plane.reshape(-1)
    assert energy["force"] == pytest.approx(whole, rel=5e-3)
    assert energy["force"] < whole


@pytest.mark.parametrize("model", MODELS)
def test_a_cantilever_bends_by_the_moment_of_its_weight(model: str) -> None:
    """-q (L - x)^2 / 2 under a slight weight q along -y, and the stress 6 M / t^2 of it, tension on top."""
    g = 1e-3
    m, s = sheet((0.0, -g, 0.0), poisson=0.0, **MODELS[model])
    xs = (np.arange(10) + 0.5) * L / 10.0
    for n, x in enumerate(xs):
        m.output(f"moment{n}", s.moment("xx", x, 0.5 * W))
        m.output(f"curvature{n}", s.curvature("xx", x, 0.5 * W))
        if model == "shell":
            m.output(f"top{n}", s.stress("xx", x, 0.5 * W))
            m.output(f"bottom{n}", s.stress("xx", x, 0.5 * W, face="bottom"))
        m.output(f"across{n}", s.moment("zz", x, 0.5 * W))
    found = mb.equilibrium(m).outputs
    exact = -0.5 * RHO * T * g * (L - xs) ** 2
    lumped = RHO * T * g * L * L / 8.0 / 10.0**2  # of weights at nodes: a chord for the parabola
    moments = np.array([found[f"moment{n}"] for n in range(10)])
    np.testing.assert_allclose(moments, exact, atol=1.1 * lumped)
    for n, moment in enumerate(moments):
        assert found[f"curvature{n}"] == pytest.approx(12.0 * moment / (E * T**3), rel=1e-9)
        assert abs(found[f"across{n}"]) < 1.1 * RHO * T * g * (W / 6.0) ** 2 / 8.0  # chord, of cells across
        if model == "shell":
            assert found[f"top{n}"] == pytest.approx(-6.0 * moment / T**2, rel=1e-4)
            assert found[f"bottom{n}"] == pytest.approx(6.0 * moment / T**2, rel=1e-4)


def test_a_sheet_that_hangs_down_has_the_tension_of_its_weight() -> None:
    """Pulled along x, far from its clamp: force per length rho t g (L - x), that over E t, contraction nu times it."""
    g, width = 9.81, 0.3 * W
    m, s = sheet((g, 0.0, 0.0), stretch=True, width=width)
    x, z = 0.55 * L, 0.5 * width
    for what in ("force_per_length", "strain"):
        for component in ("xx", "zz", "xz"):
            m.output(f"{what}.{component}", getattr(s, what)(component, x, z))
    m.output("middle", s.stress("xx", x, z, face="middle"))
    found = mb.equilibrium(m).outputs
    pull = RHO * T * g * (L - x)
    assert found["force_per_length.xx"] == pytest.approx(pull, rel=2e-3)
    assert found["middle"] == pytest.approx(found["force_per_length.xx"] / T, rel=1e-12)
    assert found["strain.xx"] == pytest.approx(pull / (E * T), rel=5e-3)
    assert found["strain.zz"] == pytest.approx(-NU * pull / (E * T), rel=2e-2)
    assert abs(found["force_per_length.xz"]) < 1e-3 * pull


@pytest.mark.parametrize("model", MODELS)
def test_a_curled_sheet_has_no_moment_in_its_arc(model: str) -> None:
    """At rest without a load: the curvature is the natural one, moments and stresses none; flat, it is the reverse."""
    kx = 4.0
    m, s = sheet((0.0, 0.0, 0.0), poisson=0.0, curl=(kx, 0.0), **MODELS[model])
    x, z = 0.35 * L, 0.25 * W
    m.output("curvature", s.curvature("xx", x, z))
    m.output("moment", s.moment("xx", x, z))
    flat = mb.Simulation(m, mb.Settings(solver="esdirk"))
    told = dict(zip([v.name for v in flat.variables], flat.outputs(), strict=True))
    D = E * T**3 / 12.0
    assert told["curvature"] == pytest.approx(0.0, abs=1e-9)
    assert told["moment"] == pytest.approx(-D * kx, rel=1e-9)
    rest = mb.equilibrium(m).outputs
    assert rest["curvature"] == pytest.approx(kx, rel=1e-3)
    assert abs(rest["moment"]) < 1e-3 * D * kx


def test_stress_is_that_of_the_thickness_there() -> None:
    m, s = sheet((0.0, -9.81e-3, 0.0), stretch=True, thickness=lambda x, _: T * (1.0 + x / L))
    x, z = 0.25 * L, 0.25 * W
    m.output("top", s.stress("xx", x, z))
    m.output("moment", s.moment("xx", x, z))
    m.output("force", s.force_per_length("xx", x, z))
    found, t = mb.equilibrium(m).outputs, 1.25 * T
    assert found["top"] == pytest.approx(found["force"] / t - 6.0 * found["moment"] / t**2, rel=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_the_twist_of_a_square_pulled_down_at_a_corner(model: str) -> None:
    """A slight force F at a corner of a plate on its three others: M_xz is F / 2 everywhere, w = F x z / (4 D_66)."""
    m = Mechanism()
    given = {"thickness": T, "youngs_modulus": E, "poisson": NU, "density": RHO, "grid": (5, 5)}
    base = m.body("base", m.ground, Weld())
    # held at one corner by a clamp of one node, pulled at its three others by a couple of couples
    s = add_sheet(
        m, "sheet", length=L, width=L, tree="spine", supports=[Support("x0", span=(0.5 * L, 0.5 * L), body=base)],
        **given, **MODELS[model],
    )  # fmt: skip
    F = 1e-5
    for (i, k), sign in (((0, 0), 1.0), ((4, 0), -1.0), ((4, 4), 1.0), ((0, 4), -1.0)):
        m.force(f"pull.{i}.{k}", PointForce(magnitude=sign * F, axis="y"), s.node(i, k))
    for x in (0.125, 0.375, 0.875):
        m.output(f"{x}", s.moment("xz", x * L, 0.625 * L))
    found = mb.equilibrium(m).outputs
    for moment in found.values():
        assert abs(moment) == pytest.approx(0.5 * F, rel=1e-2)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda s: s.moment("yy", 0.1, 0.1), "component of the loads in sheet 'sheet' is 'yy'"),
        (lambda s: s.moment("xx", -0.1, 0.1), r"x on sheet 'sheet' is -0.1 m; allowed: 0 to 0.3"),
        (lambda s: s.moment("xx", 0.1, float("nan")), "z on sheet 'sheet' is nan m"),
        (lambda s: s.strain("xx", 0.1, 0.1), "use stretch=True"),
        (lambda s: s.stress("xx", 0.1, 0.1, face="left"), "face of sheet 'sheet' is 'left'"),
    ],
)
def test_what_is_not_felt_is_refused(ask: Any, message: str) -> None:
    _, s = sheet((0.0, -9.81, 0.0))
    with pytest.raises(mb.UserError, match=message):
        ask(s)
    assert s.moment("xx", L, W).bodies[2] is s.node(-1, -1)
