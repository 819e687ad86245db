"""Four-bar whose flexible coupler is a mesh in three dimensions, against the coupler of beam elements.

``python benchmarks/meshed_fourbar.py`` prints the table of ``docs/flexible_bodies.md``. The extra ``fe`` is required.

The frame of the coupler is in its center of mass or in the first end. A frame in the end turns with the end section:
with the deflection w the other end then moves by pi w across, which lengthens the chord by (pi w)^2 / (2 L) in a theory
of first order.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache
from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray

import mbfmu as mb
from fmus.fourbar import FourBar
from mbfmu.modeling import Model, parameter

START = radians(-30.0)  # the links do not come to lie on one line
LENGTH, SIDE, MASS, YOUNG, POISSON = 3.0, 0.03, 24.057, 117e9, 0.3  # m, m, kg, Pa
LINK_LENGTH, LINK_MASS = 1.0, 8.019  # m, kg
STOP_TIME = 0.6  # s
OPTIONS = {"interval": 0.01, "solver": "radau", "tolerance": 1e-7}


@lru_cache
def coupler(cells: int, modes: int, frame: str) -> mb.FlexibleBody:
    """Return a bar of quadratic hexahedra; its end faces are rigid."""
    import skfem
    from skfem.io.meshio import to_meshio

    across = np.linspace(-0.5 * SIDE, 0.5 * SIDE, 2)
    mesh = to_meshio(skfem.MeshHex.init_tensor(np.linspace(0.0, LENGTH, cells + 1), across, across))
    middle = mb.Interface(nodes=lambda x: abs(x[:, 0] - 0.5 * LENGTH) < 1e-9, tie="average")
    return mb.FlexibleBody.from_mesh(
        mesh,
        density=MASS / (LENGTH * SIDE**2),
        young=YOUNG,
        poisson=POISSON,
        interfaces={"a": lambda x: x[:, 0] < 1e-9, "b": lambda x: x[:, 0] > LENGTH - 1e-9, "middle": middle},
        modes=modes,
        frame=frame,
    )


@dataclass(frozen=True, kw_only=True)
class MeshedFourBar(Model):
    """Four-bar with a coupler of a mesh."""

    name = "meshed_fourbar"

    modes: int = parameter(4, min=0, max=20, structural=True, doc="modes with fixed interfaces")
    cells: int = parameter(16, min=2, max=100, structural=True, doc="cells along the coupler")
    is_centered: bool = parameter(True, structural=True, doc="frame of the coupler in its center of mass")

    def build(self) -> mb.Mechanism:
        """Return the mechanism in the x-y plane."""
        m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
        link = {"mass": LINK_MASS, "length": LINK_LENGTH}
        crank = m.body("crank", m.ground, mb.Revolute(start=START, fixed=True), **mb.rod(**link))
        body = coupler(self.cells, self.modes, "center" if self.is_centered else "a")
        if self.is_centered:
            center = (LINK_LENGTH * cos(START) + 0.5 * LENGTH, LINK_LENGTH * sin(START), 0.0)
            bar = m.flexible_body("coupler", m.ground, mb.Floating(start=(*center, 1.0, 0.0, 0.0, 0.0)), body)
            m.cut("crank pin", mb.RevoluteCutJoint(at_a=(LINK_LENGTH, 0.0, 0.0)), crank, bar.section("a"))
        else:
            bar = m.flexible_body("coupler", crank, mb.Revolute(at=(LINK_LENGTH, 0.0, 0.0), start=-START), body)
        rocker = m.body("rocker", m.ground, mb.Revolute(at=(LENGTH, 0.0, 0.0), start=START), **mb.rod(**link))
        m.cut("rocker pin", mb.RevoluteCutJoint(at_b=(LINK_LENGTH, 0.0, 0.0)), bar.section("b"), rocker)
        for name in ("a", "b", "middle"):
            for axis in "xy":
                m.output(f"{name}.{axis}", bar.section(name).position(axis))
        return m


def deflection(result: mb.Result) -> NDArray[np.float64]:
    """Return the distance of the middle from the line between both pins, m, positive to the left of it."""
    a, b, middle = (np.stack([result[f"{name}.x"], result[f"{name}.y"]]) for name in ("a", "b", "middle"))
    (x, y), (u, v) = b - a, middle - a
    found: NDArray[np.float64] = (x * v - y * u) / np.hypot(x, y)
    return found


def reference() -> NDArray[np.float64]:
    """Return the deflection of the coupler of beam elements, m."""
    model = FourBar(start_angle=START, coupler_modes=4, coupler_elements=40)
    return np.asarray(mb.simulate(model, STOP_TIME, **OPTIONS)["coupler.deflection"])


def main() -> None:
    """Print the difference of the deflections for numbers of cells and both frames."""
    exact = reference()
    print(f"largest deflection of the beam: {1e3 * np.abs(exact).max():.2f} mm")
    for cells, is_centered in ((8, True), (16, True), (32, True), (8, False), (16, False), (32, False)):
        begin = time.process_time()
        result = mb.simulate(MeshedFourBar(cells=cells, is_centered=is_centered), STOP_TIME, **OPTIONS)
        difference = np.abs(deflection(result) - exact).max() / np.abs(exact).max()
        frame = "center of mass" if is_centered else "first end"
        print(f"{cells} cells, frame in the {frame}: {100 * difference:.2f} %, {time.process_time() - begin:.1f} s")


if __name__ == "__main__":
    main()
