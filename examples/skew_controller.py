"""A controller of skew as a plain PythonFMU slave: light beams in, wanted speeds of two rollers out.

The leading edge of a sheet covers the right and the left beam one after the other. The time between gives its angle,
and the time since the start how fast it turned. The controller turns it back within ``turn_back``
by a difference of the wanted speeds, and from then on keeps the part of it that works against what turned the sheet.
"""

from __future__ import annotations

import ctypes
from pathlib import Path

from described_slave import DescribedSlave
from pythonfmu import Fmi2Causality

from mbfmu.fmi.description import Experiment

# PythonFMU 0.7 drops one reference to this module's names at every instantiation and would free them.
ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))

SIDES = ("left", "right")
UNSEEN = -1.0  # s


class SkewController(DescribedSlave):
    """Finds the skew of a sheet from when its edge covers two beams, and wants speeds that take it away."""

    FILE = Path(__file__)
    TEXT = "Controller of the skew of a sheet by the difference of two rollers' speeds"
    EXPERIMENT = Experiment(stop_time=0.4, step_size=1e-3, tolerance=1e-6)
    VARIABLES = {  # noqa: RUF012
        Fmi2Causality.parameter: {
            "on": (True, "1", "whether it corrects what it finds"),
            "feed_speed": (0.5, "m/s", "speed of the sheet"),
            "radius": (0.01, "m", "radius of the rollers"),
            "nip_distance": (0.1, "m", "from the left to the right roller"),
            "sensor_spread": (0.1, "m", "from the left to the right beam"),
            "turn_back": (0.1, "s", "in which it turns the sheet back"),
        },
        Fmi2Causality.input: {
            "left_covered": (0.0, "1", "part of the left beam that the sheet covers"),
            "right_covered": (0.0, "1", "part of the right beam that the sheet covers"),
        },
        Fmi2Causality.output: {
            "left_wanted": (0.0, "rad/s", "wanted speed of the left roller"),
            "right_wanted": (0.0, "rad/s", "wanted speed of the right roller"),
            "left_seen": (UNSEEN, "s", "when the edge was in the left beam; -1: not yet"),
            "right_seen": (UNSEEN, "s", "when the edge was in the right beam; -1: not yet"),
            "skew": (0.0, "rad", "skew that was found, positive where the right side is ahead; 0: none yet"),
        },
    }
    HIDDEN = ("before", "left_before", "right_before")
    before = 0.0  # s, the point of time before this one, and what was covered then
    left_before, right_before = 1.0, 1.0  # what is covered at the start has no edge to see

    def begin(self) -> None:
        """Want the same speed of both."""
        self.left_wanted = self.right_wanted = self.feed_speed / self.radius

    def do_step(self, current_time: float, _step_size: float) -> bool:
        """Look at the beams, and want speeds for the step that begins here."""
        for side in SIDES:
            self._look(side, current_time)
        self.before = current_time
        difference = self._difference(current_time) if self.on else 0.0
        self.left_wanted = self.feed_speed / self.radius - 0.5 * difference
        self.right_wanted = self.feed_speed / self.radius + 0.5 * difference
        return True

    def _look(self, side: str, t: float) -> None:
        """Note when a beam was half covered, between the last two points of time."""
        last, now = getattr(self, f"{side}_before"), getattr(self, f"{side}_covered")
        if getattr(self, f"{side}_seen") == UNSEEN and now >= 0.5 > last:
            setattr(self, f"{side}_seen", t - (t - self.before) * (now - 0.5) / (now - last))
        setattr(self, f"{side}_before", now)

    def _difference(self, t: float) -> float:
        """Return by how much the right roller shall be faster than the left one at t (s), rad/s."""
        if UNSEEN in (self.left_seen, self.right_seen):
            return 0.0
        self.skew = self.feed_speed * (self.left_seen - self.right_seen) / self.sensor_spread
        when = max(self.left_seen, self.right_seen)
        rate = self.skew / when  # at which it has turned so far
        if t < when + self.turn_back:
            rate += self.skew / self.turn_back
        return -rate * self.nip_distance / self.radius
