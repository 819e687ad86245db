"""Blocks, first-order states and the inertia of a geared motor.

Block diagrams have inputs on the left and outputs on the right; a sampled block has a switch at its input.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch

import mbfmu.mechanics as mbm
from mbfmu.viewer.images import DPI

from .sketch import BLUE, DARK, FORCE, GRAY, LINE, SIZE, WIDTH, Sketch, compressed, element
from .solids import block, disc, gear

Point = tuple[float, float]

FILL = "#e8eefc"
HALF = SIZE[0] / SIZE[1]  # half of the width of a picture; its height is from -1 to 1
CURVE = np.linspace(0.0, 1.0, 120)


class Diagram:
    """A block diagram in a picture of the height 2."""

    def __init__(self) -> None:
        self.figure = Figure(figsize=(SIZE[0] / DPI, SIZE[1] / DPI))
        self.ax: Any = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self.ax.set_xlim(-HALF, HALF)
        self.ax.set_ylim(-1.0, 1.0)
        self.ax.axis("off")

    def box(self, text: str = "", at: Point = (0.0, 0.0), size: Point = (1.0, 0.9), points: float = 15.0) -> None:
        """Draw a block with its center at a point."""
        corner, look = (at[0] - 0.5 * size[0], at[1] - 0.5 * size[1]), "round,pad=0,rounding_size=0.06"
        self.ax.add_patch(FancyBboxPatch(corner, *size, look, fc=FILL, ec=BLUE, lw=WIDTH, zorder=2))
        self.text(text, at, points)

    def text(self, text: str, at: Point, points: float = 12.0, color: str = DARK) -> None:
        """Write a text about a point."""
        self.ax.text(*at, text, ha="center", va="center", fontsize=points, color=color, zorder=4)

    def arrow(self, *points: Point, label: str = "", shift: Point = (0.0, 0.15)) -> None:
        """Draw a signal through points, with a label near its first one."""
        *before, last = points
        self.ax.plot(*np.array(points).T, color=LINE, lw=0.8 * WIDTH, zorder=1, solid_capstyle="butt")
        head = {"arrowstyle": "-|>", "mutation_scale": 15.0, "color": LINE, "lw": 0.8 * WIDTH}
        self.ax.add_patch(FancyArrowPatch(before[-1], last, shrinkA=0.0, shrinkB=0.0, zorder=1, **head))
        if label:
            self.text(label, (points[0][0] + shift[0], points[0][1] + shift[1]))

    def through(self, left: str = "u", right: str = "y", half: float = 0.5) -> None:
        """Draw the input and the output of a block in the middle."""
        self.arrow((-HALF + 0.05, 0.0), (-half, 0.0), label=left, shift=(0.2, 0.17))
        self.arrow((half, 0.0), (HALF - 0.05, 0.0), label=right, shift=(HALF - 0.15 - half, 0.17))

    def curve(self, x: Any, y: Any, color: str = FORCE, width: float = WIDTH) -> None:
        """Draw a curve in a block."""
        self.ax.plot(x, y, color=color, lw=width, zorder=3, solid_capstyle="round")

    def axes(self, start: Point, width: float, height: float) -> None:
        """Draw thin axes from a point."""
        self.curve([start[0], start[0] + width], [start[1], start[1]], LINE, 1.2)
        self.curve([start[0], start[0]], [start[1], start[1] + height], LINE, 1.2)

    def sum_at(self, at: Point, signs: Sequence[tuple[str, Point]]) -> None:
        """Draw a sum, with signs at places relative to it."""
        self.ax.add_patch(Circle(at, 0.12, fc=FILL, ec=BLUE, lw=WIDTH, zorder=2))
        for sign, (x, y) in signs:
            self.text(sign, (at[0] + x, at[1] + y), 12.0)

    def png(self) -> bytes:
        """Return the picture."""
        buffer = BytesIO()
        with mpl.rc_context({"mathtext.fontset": "dejavuserif"}):
            self.figure.savefig(buffer, dpi=DPI, format="png", transparent=True)
        return compressed(buffer)


@element("state")
def state() -> Diagram:
    """The rate of a state is a function of the state and of other quantities; an integrator gives the state."""
    d = Diagram()
    d.box("$g$", (-0.45, 0.1), (0.6, 0.8), 20.0)
    d.box(r"$\int$", (0.55, 0.1), (0.5, 0.6), 20.0)
    for y in (0.35, 0.1):
        d.arrow((-HALF + 0.05, y), (-0.75, y))
    d.arrow((-0.15, 0.1), (0.3, 0.1), label="$z'$", shift=(0.2, 0.2))
    d.arrow((0.8, 0.1), (HALF - 0.05, 0.1), label="$z$", shift=(0.27, 0.18))
    d.arrow((1.07, 0.1), (1.07, -0.65), (-1.1, -0.65), (-1.1, -0.15), (-0.75, -0.15))
    return d


@element("lag")
def lag() -> Diagram:
    """The response of a first-order lag to a step."""
    d = Diagram()
    d.box(size=(1.3, 1.1))
    d.axes((-0.5, -0.4), 1.0, 0.8)
    d.curve([-0.5, -0.35, -0.35, 0.5], [-0.38, -0.38, 0.28, 0.28], GRAY, 1.6)
    d.curve(-0.35 + 0.85 * CURVE, -0.38 + 0.66 * (1.0 - np.exp(-4.0 * CURVE)))
    d.through(half=0.65)
    return d


@element("transfer_function")
def transfer_function() -> Diagram:
    """A ratio of polynomials of s."""
    d = Diagram()
    d.box(r"$\frac{b_1 s + b_0}{s^2 + a_1 s + a_0}$", size=(1.5, 1.0), points=16.0)
    d.through(half=0.75)
    return d


@element("state_space")
def state_space() -> Diagram:
    """The equations, with two inputs and two outputs."""
    d = Diagram()
    d.box(size=(1.5, 1.1))
    d.text("$x' = A x + B u$", (0.0, 0.2), 11.5)
    d.text("$y = C x + D u$", (0.0, -0.2), 11.5)
    for y in (0.28, -0.28):
        d.arrow((-HALF + 0.05, y), (-0.75, y))
        d.arrow((0.75, y), (HALF - 0.05, y))
    return d


@element("limiter")
def limiter() -> Diagram:
    """The output over the input."""
    d = Diagram()
    d.box(size=(1.3, 1.1))
    d.curve([-0.55, 0.55], [0.0, 0.0], LINE, 1.2)
    d.curve([0.0, 0.0], [-0.45, 0.45], LINE, 1.2)
    d.curve([-0.5, -0.25, 0.25, 0.5], [-0.32, -0.32, 0.32, 0.32])
    d.through(half=0.65)
    return d


@element("weighted_sum")
def weighted_sum() -> Diagram:
    """Three inputs with their weights, and a sum."""
    d = Diagram()
    for k, y in enumerate((0.65, 0.0, -0.65), 1):
        d.box(f"$w_{k}$", (-0.55, y), (0.55, 0.48), 13.0)
        d.arrow((-HALF + 0.05, y), (-0.825, y), label=f"$u_{k}$", shift=(0.18, 0.17))
    d.arrow((-0.275, 0.65), (0.45, 0.65), (0.45, 0.12))
    d.arrow((-0.275, 0.0), (0.33, 0.0))
    d.arrow((-0.275, -0.65), (0.45, -0.65), (0.45, -0.12))
    d.sum_at((0.45, 0.0), [("+", (0.13, 0.25)), ("+", (-0.22, 0.13)), ("+", (0.13, -0.25))])
    d.arrow((0.57, 0.0), (HALF - 0.05, 0.0), label="$y$", shift=(0.45, 0.17))
    return d


@element("pid")
def pid() -> Diagram:
    """The error of the target acts on the three parts, whose sum is limited."""
    d = Diagram()
    d.arrow((-HALF + 0.02, 0.0), (-1.12, 0.0))
    d.sum_at((-1.0, 0.0), [("+", (-0.2, 0.15)), ("$-$", (0.14, -0.24))])
    d.arrow((-1.0, -0.9), (-1.0, -0.12))
    for text, y in (("P", 0.65), ("I", 0.0), ("D", -0.65)):
        d.box(text, (-0.3, y), (0.5, 0.46), 14.0)
    d.arrow((-0.88, 0.0), (-0.55, 0.0))
    d.arrow((-0.72, 0.0), (-0.72, 0.65), (-0.55, 0.65))
    d.arrow((-0.72, 0.0), (-0.72, -0.65), (-0.55, -0.65))
    d.arrow((-0.05, 0.65), (0.3, 0.65), (0.3, 0.12))
    d.arrow((-0.05, 0.0), (0.18, 0.0))
    d.arrow((-0.05, -0.65), (0.3, -0.65), (0.3, -0.12))
    d.sum_at((0.3, 0.0), [])
    d.arrow((0.42, 0.0), (0.65, 0.0))
    d.box("", (0.88, 0.0), (0.46, 0.5))
    d.curve([0.7, 0.8, 0.96, 1.06], [-0.14, -0.14, 0.14, 0.14])
    d.arrow((1.11, 0.0), (HALF - 0.02, 0.0))
    return d


@element("dc_motor")
def dc_motor() -> Diagram:
    """The circuit: voltage, resistance, inductance, and the motor with its shaft."""
    d = Diagram()
    wire = {"color": DARK, "lw": 0.8 * WIDTH, "zorder": 1}
    d.ax.plot([-1.1, -0.95], [0.55, 0.55], **wire)
    d.ax.plot([-0.45, -0.25, 0.45, 0.45], [0.55, 0.55, 0.55, 0.28], **wire)
    d.ax.plot([0.45, 0.45, -1.1], [-0.28, -0.7, -0.7], **wire)
    d.box("R", (-0.7, 0.55), (0.5, 0.26), 11.0)
    turns = np.linspace(0.0, 3.0 * np.pi, 120)
    d.curve(-0.25 + 0.55 * turns / turns[-1], 0.57 + 0.13 * np.abs(np.sin(turns)), BLUE)
    d.text("L", (0.03, 0.86))
    d.ax.add_patch(Circle((0.45, 0.0), 0.28, fc=FILL, ec=BLUE, lw=WIDTH, zorder=2))
    d.text("M", (0.45, 0.0), 14.0)
    d.curve([0.73, 1.0], [0.0, 0.0], DARK, 2.0 * WIDTH)
    arc = np.radians(np.linspace(-120.0, 90.0, 60))
    d.curve(1.0 + 0.12 * np.cos(arc), 0.3 * np.sin(arc))
    head = {"arrowstyle": "-|>", "mutation_scale": 16.0, "color": FORCE, "lw": 0.0}
    d.ax.add_patch(FancyArrowPatch((1.02, 0.3), (0.86, 0.3), shrinkA=0.0, shrinkB=0.0, zorder=3, **head))
    for y in (0.55, -0.7):
        d.ax.add_patch(Circle((-1.1, y), 0.05, fc="white", ec=DARK, lw=WIDTH, zorder=2))
    d.arrow((-1.1, 0.4), (-1.1, -0.55), label="voltage", shift=(0.42, -0.47))
    return d


def samples(d: Diagram, half: float) -> None:
    """Draw the input with a switch, and the output."""
    d.arrow((-half - 0.2, 0.0), (-half, 0.0))
    d.ax.plot([-HALF + 0.05, -half - 0.45, -half - 0.22], [0.0, 0.0, 0.22], color=LINE, lw=0.8 * WIDTH, zorder=1)
    for x in (-half - 0.45, -half - 0.2):
        d.ax.add_patch(Circle((x, 0.0), 0.035, fc=LINE, ec=LINE, zorder=2))
    d.text("$T$", (-half - 0.38, 0.33))
    d.arrow((half, 0.0), (HALF - 0.05, 0.0))


@element("sample_hold")
def sample_hold() -> Diagram:
    """A signal and its samples, each of which is held for a period."""
    d = Diagram()
    d.box(size=(1.3, 1.1))
    d.axes((-0.5, -0.42), 1.0, 0.84)
    wave = -0.05 + 0.3 * np.sin(5.0 * CURVE)
    d.curve(-0.5 + CURVE, wave, GRAY, 1.8)
    held = np.floor(6.0 * CURVE) / 6.0
    d.curve(-0.5 + CURVE, -0.05 + 0.3 * np.sin(5.0 * held))
    samples(d, 0.65)
    return d


@element("sampled_system")
def sampled_system() -> Diagram:
    """The equations at each sample."""
    d = Diagram()
    d.box(size=(1.55, 1.1))
    d.text(r"$x \leftarrow A x + B u$", (0.0, 0.2), 11.5)
    d.text("$y = C x + D u$", (0.0, -0.2), 11.5)
    samples(d, 0.775)
    return d


@element("armature")
def armature() -> Sketch:
    """A rotor that turns fast, with a small gear on the large one of a joint."""
    s = Sketch(38.0, 20.0)
    wheel = s.body("wheel", s.a, mbm.Revolute(axis="y"))
    rotor = s.body("rotor", s.a, mbm.Revolute(at=(-1.12, 0.0, 0.0), axis="y", start=0.2))
    s.show(wheel, BLUE, *gear(0.85, 16, 0.25), disc(0.14, 0.9, axis="y", color=DARK))
    s.show(wheel, BLUE, block((1.5, 0.2, 0.3), (0.9, -0.35, 0.0)))
    s.show(rotor, DARK, *gear(0.2, 6, 0.25), disc(0.09, 1.5, (0.0, -0.5, 0.0), axis="y"))
    s.show(rotor, GRAY, disc(0.36, 0.7, (0.0, -0.75, 0.0), axis="y"))
    s.turn("y", (0.0, -0.55, 0.0), 0.6, (40.0, 140.0))
    s.turn("y", (-1.12, -1.25, 0.0), 0.5, (-60.0, 200.0), heads="end")
    return s
