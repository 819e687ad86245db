"""Surfaces that are colored by what their cells feel."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.image import imread
from scripts import NODE, evaluated
from test_page import browser, opened, scene_in

from mbfmu.mechanics import Floating, Mechanism
from mbfmu.session.run import simulate
from mbfmu.util.errors import UserError
from mbfmu.viewer import Motion, Recorder, html, images
from mbfmu.viewer.drawing import draw
from mbfmu.viewer.fields import COLOR_STOPS, Field, colored, field_with, fields

ROWS, COLUMNS = 3, 4
BALL: dict[str, Any] = {"mass": 0.1, "inertia": (1e-4, 1e-4, 1e-4)}
CELLS = [(i, k) for i in range(ROWS - 1) for k in range(COLUMNS - 1)]

FIGURE = """
const scene = JSON.parse(block("scene"));
const renderer = {
  solids: (mesh, count) => ({ data: new Float32Array(INSTANCE * count), count }),
  skin: (rows, columns, pale) => ({ data: new Float32Array(VERTEX * rows * columns), pale }),
  update() {},
};
const motion = new Motion(scene, await recorded());
const figure = new Figure(renderer, scene, motion, scene.scale, scene.stops);
"""


def grid(field: str = "push", names: Any = None, unit: str = "m") -> Mechanism:
    """Loose bodies in a grid, and outputs for its cells; ``unit`` is that of the last."""
    m = Mechanism(gravity=(0.0, 0.0, -9.81))
    bodies = [[m.body(f"b{i}{k}", m.ground, Floating(), **BALL) for k in range(COLUMNS)] for i in range(ROWS)]
    m.surface("sheet", bodies, field=field, color="#20c040")
    for i, k in CELLS if names is None else names:
        own = bodies[i][k]
        m.output(f"push[{i},{k}]", own.position("x") if unit == "m" or (i, k) != CELLS[-1] else own.velocity("x"))
    return m


def motion_of(values: Any, field: str = "push", unit: str = "N/m") -> Motion:
    """Two frames of the grid, flat and at rest, with these values (2, cells) of its field."""
    m = grid(field)
    r = np.zeros((2, len(m.bodies), 3), np.float32)
    r[:, 1:] = [(0.1 * i, 0.1 * k, 0.0) for i in range(ROWS) for k in range(COLUMNS)]
    e = np.zeros((2, len(m.bodies), 4), np.float32)
    e[..., 0] = 1.0
    return Motion(
        title="grid",
        times=np.array([0.0, 1.0]),
        names=tuple(body.name for body in m.bodies),
        parents=tuple(body.parent for body in m.bodies),
        joints=("", *("floating" for _ in m.bodies[1:])),
        outputs=(("energy", "J"), *((f"push[{i},{k}]", unit) for i, k in CELLS)),
        values=np.column_stack((np.array([99.0, 99.0]), np.asarray(values, float))),
        arrows=(),
        forces=np.zeros((2, 0, 3), np.float32),
        r=r,
        e=e,
        p=np.zeros((2, 0), np.float32),
        picture=draw(m, 0.4),
    )


RAMP = np.array([[-3.0, -2.0, -1.0, 0.0, 1.0, 2.0], [0.0, 1.0, 2.0, 3.0, 4.0, -2.0]])


def test_colors_are_moreland_s() -> None:
    parts = np.linspace(-1.0, 1.0, 101)
    expected = colormaps["coolwarm"](0.5 + 0.5 * parts)[:, :3]
    assert np.abs(colored(7.0 * parts, 7.0) - expected).max() < 0.05  # straight between every fourth of its colors
    assert colored(np.array([-20.0, 20.0]), 7.0) == pytest.approx(colored(np.array([-7.0, 7.0]), 7.0))
    assert colored(np.zeros(1), 0.0) == pytest.approx(colored(np.zeros(1), 1.0))  # a field that is zero throughout
    assert np.isnan(colored(np.array([np.nan, np.inf]), 1.0)).all()


def test_lightness_is_alike_on_both_sides() -> None:
    """By the relative luminance of the standard sRGB (IEC 61966-2-1); the color-blind read the sign by blue and red."""
    parts = np.array([0.25, 0.5, 0.75, 1.0])
    sides = [colored(sign * parts, 1.0) for sign in (-1.0, 1.0)]
    linear = [np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) for c in sides]
    below, above = (116.0 * np.cbrt(c @ (0.2126, 0.7152, 0.0722)) - 16.0 for c in linear)
    assert below == pytest.approx(above, abs=3.0)
    assert (np.diff(below) < 0.0).all()
    assert below.min() > 30.0


def test_limits_suit_the_whole_run_and_its_reference_run() -> None:
    motion, other = motion_of(RAMP), motion_of(-2.0 * RAMP)
    (own,) = fields(motion)
    assert own is not None
    assert own == Field(title="push [N/m]", low=-4.0, limit=4.0, columns=(1, 2, 3, 4, 5, 6))
    (both,) = fields(motion, other)
    assert both == replace(own, low=-8.0, limit=8.0)
    assert fields(motion, motion_of(9.0 * RAMP, unit="m"))[0] == own  # of another unit
    (rough,) = fields(motion_of(np.where(RAMP == 4.0, np.nan, RAMP)))
    assert rough == replace(own, low=-3.0, limit=3.0)
    (above,) = fields(motion_of(np.abs(RAMP), unit="1"))
    assert above == replace(own, title="push", low=0.0)
    assert fields(motion_of(RAMP, field="")) == [None]


def test_a_peak_does_not_leave_all_else_gray() -> None:
    """Of 200 values that are not zero one is a peak; ten times what is usual is none yet."""
    usual = np.concatenate((np.zeros(50), np.full(199, -2.0)))
    for peak, limit, title in ((19.0, 19.0, "push [Pa]"), (21.0, 2.0, "push [Pa], up to 21")):
        own = field_with("push", "Pa", (), np.append(usual, peak))
        assert (own.title, own.low, own.limit) == (title, -limit, limit)
    still = field_with("push", "Pa", (), np.zeros(9))
    assert (still.title, still.low, still.limit) == ("push [Pa]", 0.0, 0.0)


def test_fields_without_their_outputs_are_refused_at_the_start_of_a_run() -> None:
    for mechanism, told in (
        (grid("pull"), "field of surface 'sheet' is 'pull', but there is no output 'pull[0,0]'; it needs one for each"),
        (grid(names=CELLS[:-1]), "there is no output 'push[1,2]'; it needs one for each of the surface's cells, 'push"),
        (grid(unit="m/s"), "field of surface 'sheet' has 'push[0,0]' in m and 'push[1,2]' in m/s; allowed: one unit"),
    ):
        with pytest.raises(UserError, match=re.escape(told)):
            draw(mechanism, 1.0)
    recorder = Recorder()
    with pytest.raises(UserError, match=r"no output 'pull\[0,0\]'"):
        simulate(grid("pull"), 0.01, watch=recorder)
    assert not recorder.used
    with pytest.raises(UserError, match="field of surface 'sheet' is 3; allowed: text"):
        grid(3)  # type: ignore[arg-type]


def test_pose_file_keeps_a_field(tmp_path: Path) -> None:
    motion = motion_of(RAMP)
    motion.save(tmp_path / "m.npz")
    again = Motion.load(tmp_path / "m.npz")
    assert again.picture == motion.picture
    assert again.picture.skins[0].field == "push"
    assert fields(again) == fields(motion)
    replace(motion, outputs=motion.outputs[:-1], values=motion.values[:, :-1]).save(tmp_path / "less.npz")
    with pytest.raises(UserError, match="is a pose file of another version of mbfmu"):
        Motion.load(tmp_path / "less.npz")


def pixels(motion: Motion, path: Path) -> Any:
    """A picture of a motion's start from above, (height, width, 3): the surface in the middle third of the width."""
    images.write_png(motion, path, 0.0, images.Shot(720, 240, azimuth=0.0, elevation=89.0))
    return imread(path)[..., :3]


def test_picture_shows_cells_by_the_sign_of_their_values(tmp_path: Path) -> None:
    def counted(values: Any, field: str = "push") -> tuple[int, int, int]:
        """How many pixels of the surface are red, blue, and green, which is its own color."""
        shown = pixels(motion_of(values, field), tmp_path / "m.png")[:, 240:480]
        strong = np.ptp(shown, axis=-1) > 0.2
        found = np.bincount(np.argmax(shown, axis=-1)[strong], minlength=3)
        return int(found[0]), int(found[2]), int(found[1])

    red, blue, green = counted([[3.0, 3.0, 3.0, 3.0, 3.0, -3.0]] * 2)
    assert red == pytest.approx(5 * blue, rel=0.15)
    assert blue > 500
    assert green == 0
    red, blue, green = counted([[np.nan, 3.0, 3.0, 3.0, 3.0, -3.0]] * 2)
    assert red == pytest.approx(4 * blue, rel=0.15)
    assert green == pytest.approx(blue, rel=0.25)
    plain = counted(RAMP, "")
    assert plain[:2] == (0, 0)


def test_picture_explains_its_colors(tmp_path: Path) -> None:
    corners = {field: pixels(motion_of(RAMP, field), tmp_path / "m.png")[:, 460:] for field in ("push", "")}
    assert not np.array_equal(corners["push"], corners[""])
    for stop in (COLOR_STOPS[0], COLOR_STOPS[-1]):
        color = [int(stop[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
        close = {field: int((np.abs(corner - color).max(axis=-1) < 0.03).sum()) for field, corner in corners.items()}
        assert close["push"] > 10
        assert close[""] == 0


def test_page_of_two_runs_has_one_scale_of_colors() -> None:
    scene = scene_in(html.page(motion_of(RAMP), motion_of(-2.0 * RAMP))[0])
    (own,), (beside,) = scene["fields"], scene["against"]["fields"]
    assert own == beside == {"title": "push [N/m]", "low": -8.0, "limit": 8.0, "columns": [1, 2, 3, 4, 5, 6]}
    assert scene["stops"] == list(COLOR_STOPS)
    assert scene_in(html.page(motion_of(RAMP, ""))[0])["fields"] == [None]


@pytest.mark.skipif(NODE is None, reason="no node here, which the page's program is tested with")
@pytest.mark.parametrize("time", [0.0, 0.25, 1.0])
def test_page_colors_every_cell_by_its_value_at_that_time(time: float) -> None:
    found = evaluated(
        FIGURE
        + f"""
        figure.place({time});
        const {{ data, pale }} = figure.skins[0].item;
        return {{ data: Array.from(data), pale, vertex: VERTEX }};
        """,
        html.page(motion_of(np.where(RAMP == 1.0, np.nan, RAMP)))[0],
    )
    corners = np.reshape(found["data"], (ROWS, COLUMNS, found["vertex"]))
    shown = corners[1:, :-1, 6:].reshape(-1, 3)
    values = (1.0 - time) * RAMP[0] + time * RAMP[1]
    rough = (RAMP == 1.0).any(axis=0)
    assert shown[~rough] == pytest.approx(colored(values, 4.0)[~rough], abs=1e-6)
    own = [0x20 / 255.0, 0xC0 / 255.0, 0x40 / 255.0]
    if 0.0 < time < 1.0:
        assert shown[rough] == pytest.approx(np.tile(own, (rough.sum(), 1)), abs=1e-6)
    assert found["pale"] == 0
    assert corners[..., :3].reshape(-1, 3) == pytest.approx(motion_of(RAMP).r[0, 1:], abs=1e-7)


@pytest.mark.skipif(NODE is None, reason="no node here, which the page's program is tested with")
def test_both_triangles_of_a_cell_end_in_the_corner_that_has_its_color() -> None:
    """With `flat`, WebGL 2 takes the color of a triangle from its last corner."""
    faces = evaluated(
        """
        const gl = { createVertexArray() {}, bindVertexArray() {} };
        const buffer = (data) => Array.from(data);
        const { skin, surface } = Renderer.prototype;
        return skin.call({ gl, buffer, surface, attribute() {} }, 3, 4, 0).faces;
        """
    )
    triangles = np.reshape(faces, (-1, 2, 3))
    assert triangles[:, :, 2].tolist() == [[(i + 1) * COLUMNS + k] * 2 for i, k in CELLS]
    for (i, k), pair in zip(CELLS, triangles, strict=True):
        a = i * COLUMNS + k
        assert set(pair.ravel()) == {a, a + 1, a + COLUMNS, a + COLUMNS + 1}
        for corners in pair:  # all turn the same way
            at = np.array(np.unravel_index(corners, (ROWS, COLUMNS))).T
            assert np.linalg.det([at[1] - at[0], at[2] - at[0]]) == pytest.approx(1.0)


@pytest.mark.skipif(NODE is None, reason="no node here, which the page's program is tested with")
def test_surface_without_a_field_has_one_color() -> None:
    found = evaluated(
        FIGURE
        + """
        figure.place(0.5);
        const { item } = figure.skins[0];
        return [Array.from(item.data), item.pale, VERTEX];
        """,
        html.page(motion_of(RAMP, ""))[0],
    )
    colors = np.reshape(found[0], (-1, found[2]))[:, 6:]
    assert colors == pytest.approx(np.tile([0x20 / 255.0, 0xC0 / 255.0, 0x40 / 255.0], (ROWS * COLUMNS, 1)), abs=1e-6)
    assert found[1] > 0.0


@pytest.mark.skipif(NODE is None, reason="no node here, which the page's program is tested with")
@pytest.mark.parametrize(
    ("low", "limit", "stops", "ticks"),
    [
        (-0.00456, 0.00456, COLOR_STOPS, ["-0.00456", "0", "0.00456"]),
        (0.0, 0.00456, COLOR_STOPS[4:], ["0", "0.00456"]),
        (0.0, 0.0, COLOR_STOPS[4:], ["0"]),
    ],
)
def test_page_explains_its_colors(low: float, limit: float, stops: tuple[str, ...], ticks: list[str]) -> None:
    own = {"title": "push [N/m]", "low": low, "limit": limit}
    scene = {"fields": [None, own], "stops": COLOR_STOPS, "against": None}
    viewer = (Path(html.__file__).parent / "page" / "viewer.js").read_text().replace("start().catch", "(() => {}).call")
    found = evaluated(
        f"""
        const made = () => ({{ style: {{}}, children: [], append(...own) {{ this.children.push(...own); }} }});
        const root = made();
        document.createElement = made;
        document.getElementById = () => root;
        const Viewer = (() => {{ {viewer.replace("async function start", "return Viewer; async function start")} }})();
        Viewer.prototype.prepareFields.call({{ scene: {json.dumps(scene)} }});
        const [title, bar, scale] = root.children;
        return [root.hidden, title.textContent, bar.style.background, scale.children.map((own) => own.textContent)];
        """
    )
    assert found == [False, "push [N/m]", f"linear-gradient(to right, {', '.join(stops)})", ticks]


@pytest.mark.skipif(browser() is None, reason="no Chromium here; MBFMU_BROWSER may name one")
def test_a_browser_colors_cells_by_the_sign_of_their_values(tmp_path: Path) -> None:
    """Without a field the surface is green, with one it is red and blue, and below it stands the bar of colors."""
    page, picture = tmp_path / "page.html", tmp_path / "page.png"
    found = {}
    for field in ("push", ""):
        html.write_html(motion_of([[3.0, 3.0, 3.0, 3.0, 3.0, -3.0]] * 2, field), page)
        assert 'data-state="ready"' in opened(page, "--dump-dom")
        opened(page, f"--screenshot={picture}")
        seen = imread(picture)[60:330, :400, :3]  # above the bar, left of the curves
        strong = np.ptp(seen, axis=-1) > 0.35
        found[field] = np.bincount(np.argmax(seen, axis=-1)[strong], minlength=3)
    red, green, blue = found["push"]
    assert red > 3 * blue > 300
    assert green == 0
    assert found[""][1] > 1000
    assert found[""][0] == found[""][2] == 0
