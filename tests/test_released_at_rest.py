"""A parallelogram released at rest just next to its flat position, through which it may fall: it is a pendulum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbfmu.mechanics import Mechanism, Revolute, RevoluteCutJoint
from mbfmu.modeling import Model
from mbfmu.modeling.settings import Settings
from mbfmu.session.run import run

G, INERTIA = 9.81, 0.1  # m/s2; moment of inertia of a bar of length 1 and mass 1
TIMES = np.linspace(0.0, 1.0, 21)


@dataclass(frozen=True, kw_only=True)
class Parallelogram(Model):
    """Two cranks of 1 m and a coupler, with masses anywhere."""

    start: float  # rad, from flat
    masses: tuple[float, ...]
    ground: float
    centers: tuple[tuple[float, float], ...]  # of mass, m

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -G, 0.0))
        own = [
            {"mass": M, "com": (*c, 0.0), "inertia": (0.02 * M * l * l, 0.09 * M * l * l, INERTIA * M * l * l)}
            for M, c, l in zip(self.masses, self.centers, (1.0, self.ground, 1.0), strict=True)
        ]
        crank = m.body("crank", m.ground, Revolute(start=self.start, fixed=True), **own[0])
        coupler = m.body("coupler", crank, Revolute(at=(1.0, 0.0, 0.0), start=-self.start), **own[1])
        rocker = m.body("rocker", m.ground, Revolute(at=(self.ground, 0.0, 0.0), start=self.start), **own[2])
        m.cut("pin", RevoluteCutJoint(at_a=(self.ground, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), coupler, rocker)
        m.output("crank", crank.angle())
        m.output("rocker", rocker.angle())
        return m

    def exact(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """The angle of both cranks; the coupler does not turn."""
        (first, middle, last), (here, _, there) = self.masses, self.centers
        inertia = sum(M * (INERTIA + c[0] ** 2 + c[1] ** 2) for M, c in ((first, here), (last, there))) + middle
        x, y = first * here[0] + middle + last * there[0], first * here[1] + last * there[1]

        def rate(_: float, state: np.ndarray) -> list[float]:
            angle, speed = state
            return [speed, -G * (x * np.cos(angle) - y * np.sin(angle)) / inertia]

        known = solve_ivp(rate, (0.0, times[-1]), [self.start, 0.0], "DOP853", t_eval=times, rtol=1e-12, atol=1e-13)
        return {"crank": known.y[0], "rocker": known.y[0]}


def drawn(seed: int) -> Parallelogram:
    rng = np.random.default_rng(seed)
    ground = rng.uniform(1.2, 4.0)
    places = ((0.2, 0.9), (0.5 * ground, 0.5 * ground), (0.2, 0.9))
    return Parallelogram(
        start=float(10.0 ** rng.uniform(-6.0, -3.5)),
        masses=tuple(10.0 ** rng.uniform(-1.5, 1.5, 3)),
        ground=ground,
        centers=tuple((rng.uniform(*place), rng.uniform(-0.3, 0.3)) for place in places),
    )


@pytest.mark.parametrize("seed", range(16))
@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
def test_it_falls_as_a_pendulum_or_is_refused(solver: str, seed: int) -> None:
    model = drawn(seed)
    exact = model.exact(TIMES)
    for tolerance in (1e-4, 1e-6, 1e-8):
        result = run(model, Settings(solver=solver, tolerance=tolerance), TIMES)
        off = max(abs(result[name] - exact[name][: len(result.t)]).max() for name in exact)
        assert off <= 100.0 * tolerance or result.failure or result.warning
        assert not result.failure or (solver == "ida" and tolerance < 1e-4)
