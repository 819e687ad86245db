"""The page's program: its clock, what it unpacks, its curves, its arrows and what a click picks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recording import recorded
from scripts import NODE, evaluated

from fmus.fourbar import FourBar
from fmus.governor import Governor
from mbfmu.viewer import Motion, html

pytestmark = pytest.mark.skipif(NODE is None, reason="no node here, which the page's program is tested with")

FIGURE = """
const scene = JSON.parse(block("scene"));
const motion = new Motion(scene, await recorded());
const renderer = {
  solids: (mesh, count) => ({ data: new Float32Array(INSTANCE * count), count }),
  skin: (rows, columns) => ({ data: new Float32Array(VERTEX * rows * columns) }),
  update() {},
  lines() {},
};
const figure = new Figure(renderer, scene, motion, scene.scale, scene.stops);
"""


def test_clock_stays_between_the_first_and_the_last_frame() -> None:
    times = evaluated("""
        const clock = new Clock([1, 2, 4]), seen = [];
        clock.playing = true;
        for (const now of [100, 50, 20]) { clock.tick(now); seen.push(clock.time); }
        clock.goTo(-3); seen.push(clock.time);
        clock.goTo(9); seen.push(clock.time);
        clock.loop = false; clock.tick(200); seen.push(clock.time, clock.playing);
        clock.step(1); seen.push(clock.time); clock.step(-1); seen.push(clock.time);
        clock.toggle(); clock.halt(4); clock.toggle(); seen.push(clock.time, clock.playing);
        return seen;
    """)
    assert times == [1, 1, 1, 1, 4, 4, False, 4, 2, 1, True]


def test_clock_loops_and_changes_its_speed() -> None:
    found = evaluated("""
        const clock = new Clock([0, 2]);
        clock.changeSpeed(1);
        const speeds = [clock.speed];
        clock.changeSpeed(-99); speeds.push(clock.speed);
        clock.speed = 100; clock.playing = true; clock.tick(0); clock.tick(30);
        return [...speeds, clock.time, clock.playing, new Clock([0, 0.001]).speed];
    """)
    assert found == [2, 0.001, 0, True, 0.001]


def test_page_unpacks_what_was_recorded() -> None:
    result, motion = recorded(Governor(), 0.2)
    found = evaluated(
        FIGURE
        + """
        motion.place(0.1);
        const outputs = Object.fromEntries(motion.outputs.map(({ name, values }) => [name, Array.from(values)]));
        return { times: Array.from(motion.times), r: Array.from(motion.r), e: Array.from(motion.e),
          f: Array.from(motion.f), outputs, units: motion.outputs.map(({ unit }) => unit) };
        """,
        html.page(motion)[0],
    )
    k = motion.frame(0.1)
    assert found["times"] == motion.times.tolist()
    assert found["r"] == pytest.approx(motion.r[k].ravel(), abs=1e-7)
    assert found["e"] == pytest.approx(motion.e[k][html.turning_bodies(motion)].ravel(), abs=1e-6)
    assert found["f"] == pytest.approx(motion.forces[k].ravel(), rel=1e-6, abs=1e-5)
    assert found["outputs"]["collar.height"] == pytest.approx(result["collar.height"], abs=1e-8)
    strays = np.array(found["outputs"]["energy"]) - result["energy"]  # far less than single precision has of it
    assert np.abs(strays).max() < 1e-6 * np.ptp(result["energy"]) + 1e-15 * np.abs(result["energy"]).max()
    assert found["units"] == [unit for _, unit in motion.outputs]


def beside() -> tuple[Motion, Motion]:
    """A run, and a shorter one of another mass whose frames lie between those of the first."""
    _, motion = recorded(FourBar(), 0.3)
    _, other = recorded(FourBar(crank_mass=2.0), 0.2)
    return motion, replace(other, times=other.times + 0.0025, title="other")


def test_curves_of_two_runs_share_their_times() -> None:
    motion, other = beside()
    found = evaluated(
        """
        const scene = JSON.parse(block("scene"));
        const motions = [new Motion(scene, await recorded()), new Motion(scene.against, await recorded("-against"))];
        const [times, own, other] = table(motions, ["crank.angle"]);
        return { times, own, other, at: valueAt(motions[0], "crank.angle", 0.105),
          beyond: valueAt(motions[1], "crank.angle", 0.25) };
        """,
        html.page(motion, other)[0],
    )
    column = [name for name, _ in motion.outputs].index("crank.angle")
    assert found["times"] == sorted({*motion.times.tolist(), *other.times.tolist()})
    own = [x for x in found["own"] if x is not None]
    assert own == pytest.approx(motion.values[:, column], abs=1e-6)
    assert [x for x in found["other"] if x is not None] == pytest.approx(other.values[:, column], abs=1e-6)
    assert found["at"] == pytest.approx(motion.values[10:12, column].mean(), abs=1e-6)
    assert found["beyond"] is None


def test_readouts_are_reported_for_both_runs() -> None:
    motion, other = beside()
    names = ("coupler.angle", "energy")
    motion, other = (replace(run, picture=replace(run.picture, shown_outputs=names)) for run in (motion, other))
    viewer = (Path(html.__file__).parent / "page" / "viewer.js").read_text().replace("start().catch", "(() => {}).call")
    found = evaluated(
        f"""
        const root = {{ children: [], append(...own) {{ this.children.push(...own); }} }};
        const page = document.getElementById;
        document.createElement = () => ({{ ...root, children: [] }});
        document.getElementById = (id) => (id === "shown_outputs" ? root : page(id));
        const Viewer = (() => {{ {viewer.replace("async function start", "return Viewer; async function start")} }})();
        const scene = JSON.parse(block("scene"));
        const motions = [new Motion(scene, await recorded()), new Motion(scene.against, await recorded("-against"))];
        const own = {{ scene, motions }};
        Viewer.prototype.prepareReadouts.call(own);
        const lines = root.children.map((line) => line.children[0].textContent);
        const read = (time) => own.shown_outputs.map(({{ name }}) => reading(motions, name, time));
        return [lines, [0.105, 0.25].map(read)];
        """,
        html.page(motion, other)[0],
    )
    assert found[0] == list(names)
    for time, told in zip((0.105, 0.25), found[1], strict=True):
        for name, unit, text in zip(names, ("rad", "J"), told, strict=True):
            column = [own for own, _ in motion.outputs].index(name)
            runs = (motion, other) if time < other.times[-1] else (motion,)
            values = [np.interp(time, run.times, run.values[:, column]) for run in runs]
            assert text.endswith(f" {unit}")
            assert [float(part) for part in text.removesuffix(unit).split("|")] == pytest.approx(values, rel=1e-3)


def test_click_picks_the_body_it_meets_first() -> None:
    _, motion = recorded(FourBar(), 0.5)
    coupler, crank = (motion.names.index(name) for name in ("coupler", "crank"))
    bar, ball = motion.point(coupler, (1.0, 0.0, 0.0))[10, 0], motion.point(crank, (0.5, 0.0, 0.0))[10, 0]
    found = evaluated(
        FIGURE
        + f"""
        figure.place({motion.times[10]});
        const seen = (x, y) => picked(figure, [x, y, 20], [0, 0, -1]);
        const behind = picked(figure, [{bar[0]}, {bar[1]}, -20], [0, 0, -1]);
        return [seen({bar[0]}, {bar[1]}), seen({ball[0]}, {ball[1]}), seen({bar[0]}, {bar[1]} + 0.5), behind];
        """,
        html.page(motion)[0],
    )
    assert found == [coupler, crank, None, None]


def test_joint_position_and_speed_of_a_picked_body_are_shown() -> None:
    result, motion = recorded(FourBar(), 0.5)
    found = evaluated(
        FIGURE + "figure.place(0.253); return told(scene, motion, scene.bodies.indexOf('coupler'), 0.253);",
        html.page(motion)[0],
    )
    told = dict(found)
    speed = np.hypot(result["coupler.velocity.x"], result["coupler.velocity.y"])
    x = np.interp(0.253, result.t, result["coupler.position.x"])
    assert told["body"] == "coupler"
    assert told["joint"] == "revolute, on crank"
    assert float(told["position"].split(",")[0]) == pytest.approx(x, rel=1e-3)
    assert float(told["speed"].split()[0]) == pytest.approx(np.interp(0.253, result.t, speed), rel=1e-3)


def test_arrow_is_as_long_as_its_force_by_the_scale() -> None:
    _, motion = recorded(Governor(), 0.2)
    ways = evaluated(
        FIGURE
        + """
        const arrows = new Arrows(renderer, scene, motion);
        figure.place(0.1);
        arrows.place();
        const own = ({ data }, k) => Array.from(data.slice(INSTANCE * k, INSTANCE * k + 12));
        return { ways: scene.arrows.map((_, k) => arrows.way(k)), legend: arrows.legend, scales: scene.scales,
          feet: scene.arrows.map((_, k) => own(arrows.shafts, k)),
          tips: scene.arrows.map((_, k) => own(arrows.heads, 2 * k)) };
        """,
        html.page(motion)[0],
    )
    frame = motion.frame(0.1)
    for k, (arrow, way) in enumerate(zip(motion.arrows, ways["ways"], strict=True)):
        value, length = ways["scales"][arrow.unit]
        if way is not None and arrow.unit == "N":
            assert way == pytest.approx(motion.forces[frame, k] * length / value, rel=1e-5, abs=1e-7)
            shaft, tip = np.reshape(ways["feet"][k], (4, 3)), np.reshape(ways["tips"][k], (4, 3))
            foot = motion.point(arrow.body, arrow.at)[frame, 0]
            assert shaft[3] - 0.5 * shaft[2] == pytest.approx(foot, abs=1e-6)
            assert tip[3] + 0.5 * tip[2] == pytest.approx(foot + way, abs=1e-6)
    assert sum(way is not None for way in ways["ways"]) >= 3
    assert all(f"{unit} = " in text for unit, text in zip(ways["scales"], ways["legend"], strict=True))


def test_numbers_and_ticks_have_the_figures_they_need() -> None:
    found = evaluated("""
        return [figures(0), figures(123456), figures(0.05), figures(-3.381e-8), figures(0.30000000000000004),
          ticks([0, 0.5, 1]), ticks([-4e-8, -2e-8, 0]), ticks([42.125, 42.126, 42.127]), ticks([1e6, 2e6])];
    """)
    assert found == [
        "0", "1.235e+5", "0.05", "-3.381e-8", "0.3",
        ["0", "0.5", "1"], ["-4e-8", "-2e-8", "0"], ["42.125", "42.126", "42.127"], ["1e+6", "2e+6"],
    ]  # fmt: skip
