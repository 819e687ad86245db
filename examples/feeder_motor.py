"""A feeder whose rollers two motors turn, and a controller of skew: ``python examples/feeder_motor.py [-o FOLDER]``.

The feeder (``fmus/feeder``) is an FMU: speeds of the rollers in, torques and what two beams of light see out. A motor
(:class:`Motor`, plain Python) has inertia and a speed loop; the left one's tachometer reads ERROR too much, so that the
left roller is slow and the sheet turns. From the time between the leading edge in the right and in the left beam the
controller finds by how much, turns the sheet back within TURN_BACK, and goes on against what turned it.

Writes the FMU and ``feeder_motor.png`` into the folder. :func:`co_simulate` is the loop to copy.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from fmus.feeder import Feeder
from mbfmu.fmi import Fmu, export

MODEL = Feeder(path="straight", nips=1, nx=9, nz=7, sensor_distance=0.06)
ERROR = 0.02  # of the left tachometer
STOP_TIME, STEP = 0.4, 1e-3  # s
TURN_BACK = 0.1  # s

Array = NDArray[np.float64]


class Motor:
    """A rotor with a proportional and integral speed loop; what its tachometer reads is ``reads`` of its speed."""

    INERTIA, GAIN, RESET, STRONGEST = 2e-5, 4e-3, 0.2, 0.1  # kg m^2, N m s/rad, N m/rad, N m

    def __init__(self, speed: float, reads: float) -> None:
        self.reads, self.speed, self.sum = reads, speed / reads, 0.0

    def step(self, wanted: float, load: float, h: float) -> None:
        """Go on by h (s) against a torque ``load`` (N m)."""
        error = wanted - self.reads * self.speed
        torque = np.clip(self.GAIN * error + self.RESET * self.sum, -self.STRONGEST, self.STRONGEST)
        self.sum += h * error
        self.speed += h * (torque - load) / self.INERTIA


class Controller:
    """Tells the difference of the wanted speeds, right less left, rad/s, from when the beams are covered."""

    def __init__(self) -> None:
        self.seen: dict[str, float] = {}
        self.before = {"left": 0.0, "right": 0.0}
        self.skew = 0.0

    def difference(self, t: float, beams: dict[str, float], h: float) -> float:
        """Return it at t (s); ``beams`` are how much of each is covered now."""
        for side, now in beams.items():
            if side not in self.seen and now >= 0.5 > self.before[side]:  # between two points of time
                self.seen[side] = t - h * (now - 0.5) / (now - self.before[side])
            self.before[side] = now
        if len(self.seen) < 2:
            return 0.0
        self.skew = MODEL.speed * (self.seen["left"] - self.seen["right"]) / MODEL.sensor_spread
        when = max(self.seen.values())
        rate = self.skew / when  # at which it has turned so far
        if t < when + TURN_BACK:
            rate += self.skew / TURN_BACK
        return -rate * MODEL.nip_distance / MODEL.radius


def co_simulate(fmu: Path, *, controlled: bool) -> tuple[Array, Array, float]:
    """Return times (s), skew (rad) at them, and the skew that the controller found."""
    speed = MODEL.speed / MODEL.radius
    motors = {"left": Motor(speed, 1.0 + ERROR), "right": Motor(speed, 1.0)}
    controller, times, skews = Controller(), [0.0], [0.0]
    with Fmu(fmu) as feeder:
        for k in range(round(STOP_TIME / STEP)):
            beams = {side: feeder[f"sensor[1].{side}.covered"] for side in motors}
            more = controller.difference(k * STEP, beams, STEP) if controlled else 0.0
            for hand, (side, motor) in zip((-0.5, 0.5), motors.items(), strict=True):
                motor.step(speed + hand * more, feeder[f"roller[1].{side}.torque"], STEP)
                feeder[f"roller[1].{side}.speed"] = motor.speed
            feeder.step(STEP)
            times.append((k + 1) * STEP)
            skews.append(feeder["sheet.skew"])
    return np.array(times), np.array(skews), controller.skew


def main() -> None:
    """Run without and with the controller, and draw both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("results/feeder_motor"), help="folder")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    fmu = export(MODEL, folder / "feeder.fmu")
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for controlled in (False, True):
        times, skews, found = co_simulate(fmu, controlled=controlled)
        axes.plot(times, 1e3 * skews, label=f"controller {'on' if controlled else 'off'}")
        print(f"controller {'on, found' if controlled else 'off,'} {found:.5f} rad: skew ends at {skews[-1]:.5f} rad")
    axes.set(xlabel="time, s", ylabel="skew of the leading edge, mrad")
    axes.legend()
    axes.grid(alpha=0.3)
    figure.savefig(folder / "feeder_motor.png", dpi=150)


if __name__ == "__main__":
    main()
