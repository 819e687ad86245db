"""Steady states know no units: copies in other lengths, masses and times stand alike, or are refused alike."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, sin

import numpy as np
import pytest

from mbfmu.mechanics import JointSpring, Mechanism, Polynomial, Revolute, SphericalCutJoint, Translational, rod
from mbfmu.modeling import Model
from mbfmu.sheets import Support, add_sheet
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.steady.state import position_names
from mbfmu.util.errors import EquilibriumError

SCALES = [(1e-3, 1.0, 1.0), (1e3, 1.0, 1.0), (1.0, 1e-6, 1.0), (1e-3, 1e-6, 1e-2), (1e3, 1e6, 1e2), (1e-3, 1e3, 10.0)]


@dataclass(frozen=True, kw_only=True)
class Copy(Model):
    """A model in other units, given by the numbers of its units in a meter, a kilogram and a second."""

    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0

    @property
    def gravity(self) -> float:
        """m/s^2."""
        return 9.81 * self.length / self.time**2


@dataclass(frozen=True, kw_only=True)
class Umbrella(Copy):
    """An arm on a column that turns, carried by a link on a collar with a spring; ``lean`` is that of gravity, rad."""

    name = "umbrella"
    lean: float = 0.0

    def build(self) -> Mechanism:
        L, M, T = self.length, self.mass, self.time
        m = Mechanism(gravity=(self.gravity * sin(self.lean), -self.gravity * cos(self.lean), 0.0))
        column = m.body("column", m.ground, Revolute(axis="y", drive=Polynomial((0.4, 4.0 / T))), mass=3.0 * M)
        arm = m.body("arm", column, Revolute(start=-0.2), **rod(mass=2.0 * M, length=L))
        collar = m.body("collar", column, Translational(axis="y", start=-0.6 * L), mass=1.5 * M)
        link = m.body("link", collar, Revolute(start=0.8), **rod(mass=0.3 * M, length=0.7 * L))
        m.force("spring", JointSpring(stiffness=400.0 * M / T**2, free=-0.4 * L), collar)
        m.cut("tie", SphericalCutJoint(at_a=(0.7 * L, 0.0, 0.0), at_b=(0.6 * L, 0.0, 0.0)), link, arm)
        m.output("angle", arm.angle())
        return m


@dataclass(frozen=True, kw_only=True)
class Flag(Copy):
    """A sheet that is led downhill from one edge, with dense matrices or as a tree."""

    name = "flag"
    grid: tuple[int, int] = (5, 3)

    def build(self) -> Mechanism:
        L, M, T = self.length, self.mass, self.time
        m = Mechanism(gravity=(0.0, -self.gravity, 0.0))
        add_sheet(
            m, "flag", length=0.3 * L, width=0.2 * L, thickness=3e-4 * L, youngs_modulus=2e9 * M / (L * T**2),
            poisson=0.3, density=1000.0 * M / L**3, grid=self.grid, supports=[Support("x1")],
        )  # fmt: skip
        m.output("energy", m.energy)
        return m


def stands(model: Copy) -> np.ndarray:
    """Positions of the steady state, in units of the copy."""
    found = equilibrium(model)
    slides = [name.endswith(("alpha", "collar")) for name in position_names(found.compiled)]
    return found.q / np.where(slides, model.length, 1.0)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("model", [Umbrella(), Flag(), Flag(grid=(9, 6))], ids=["loop", "dense", "tree"])
def test_a_copy_stands_where_the_original_does(model: Copy, scale: tuple[float, float, float]) -> None:
    length, mass, time = scale
    copy = replace(model, length=length, mass=mass, time=time)
    np.testing.assert_allclose(stands(copy), stands(model), atol=1e-8)


@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), *SCALES])
def test_gravity_across_the_column_is_refused_in_any_units(scale: tuple[float, float, float]) -> None:
    length, mass, time = scale
    with pytest.raises(EquilibriumError, match="does not turn with it"):
        equilibrium(Umbrella(lean=1e-4, length=length, mass=mass, time=time))


@pytest.mark.parametrize("copy", [{"mass": 1e-20}, {"length": 1e-7}, {"length": 1e7}])
def test_copies_beyond_all_measure_stand_alike_and_are_linearized_alike(copy: dict[str, float]) -> None:
    found = [equilibrium(model) for model in (Umbrella(), Umbrella(**copy))]
    eigenvalues = [np.sort_complex(np.linalg.eigvals(result.state_space.A)) for result in found]
    np.testing.assert_allclose(eigenvalues[1], eigenvalues[0], rtol=1e-6)
    assert found[1].outputs["angle"] == pytest.approx(found[0].outputs["angle"], abs=1e-8)
