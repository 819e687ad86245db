"""The page, pictures and films, and the commands that make them."""

from __future__ import annotations

import base64
import json
import os
import re
import shlex
import shutil
import subprocess
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from PIL import Image
from recording import recorded

from fmus.fourbar import FourBar
from fmus.governor import Governor
from mbfmu.cli import parser
from mbfmu.cli.common import scene_of
from mbfmu.cli.view import with_view_settings
from mbfmu.mechanics import Floating, Mechanism, PointForce, Revolute, rod
from mbfmu.modeling import Model
from mbfmu.session.run import simulate
from mbfmu.sheets import Support, add_sheet
from mbfmu.util.errors import UserError
from mbfmu.viewer import Motion, Recorder, html, images
from mbfmu.viewer.drawing import draw
from mbfmu.viewer.show import view

Command = Callable[..., Any]

BROWSERS = ("chromium", "chromium-browser", "chromium-headless-shell", "google-chrome", "chrome")


def flat_sheet(rows: int = 3, columns: int = 4) -> tuple[Mechanism, Motion]:
    m = Mechanism(gravity=(0.0, 0.0, -9.81))
    cells = [[m.body(f"cell{i}{j}", m.ground, Floating(), mass=0.1) for j in range(columns)] for i in range(rows)]
    m.surface("sheet", cells)
    r = np.zeros((2, len(m.bodies), 3), np.float32)
    for i in range(rows):
        for j in range(columns):
            r[:, cells[i][j].index] = (0.1 * i, 0.1 * j, 0.01 * i * j)
    e = np.zeros((2, len(m.bodies), 4), np.float32)
    e[..., 0] = 1.0
    names, parents = tuple(b.name for b in m.bodies), tuple(b.parent for b in m.bodies)
    motion = Motion(
        title="a <b>",
        times=np.array([0.0, 1.0]),
        names=names,
        parents=parents,
        joints=("", *("floating" for _ in m.bodies[1:])),
        outputs=(),
        values=np.zeros((2, 0)),
        arrows=(),
        forces=np.zeros((2, 0, 3), np.float32),
        r=r,
        e=e,
        p=np.zeros((2, 0), np.float32),
        picture=draw(m, 0.4),
    )
    return m, motion


def embedded(page: str, name: str, kind: str) -> np.ndarray[Any, Any]:
    """Numbers of a block of a page: (T, n)."""
    block, times = (
        re.search(rf'<script type="application/octet-stream" id="{own}">(.*?)</script>', page)
        for own in (name, name.replace(name.split("-", maxsplit=1)[0], "times"))
    )
    assert block is not None
    assert times is not None
    planes, whole = (np.frombuffer(zlib.decompress(base64.b64decode(found[1])), np.uint8) for found in (block, times))
    steps = np.ascontiguousarray(planes.reshape(4, -1).T).view("<u4").reshape(-1, whole.size // 8)
    return np.ascontiguousarray(np.cumsum(steps, axis=1, dtype=np.uint32).T).view(kind)


def scene_in(page: str) -> dict[str, Any]:
    block = re.search(r'id="scene">(.*?)</script>', page)
    assert block is not None
    scene: dict[str, Any] = json.loads(block[1])
    return scene


def test_bent_bar_is_closed_and_faces_outward() -> None:
    angle = np.linspace(0.0, 1.0, 65)
    axis = 2.0 * np.stack((np.sin(angle), 1.0 - np.cos(angle), 0.0 * angle), axis=-1)
    faces = images.bent(axis, np.array([0.0, 0.0, 1.0]), 0.2, 0.3)
    normals = 0.5 * np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
    assert normals.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)
    volume = np.einsum("ij,ij->", faces.mean(axis=1), normals) / 3.0
    assert volume == pytest.approx(2.0 * 0.2 * 0.3, rel=1e-3)  # Pappus: length of the axis times the section


def test_run_then_view(command: Command, tmp_path: Path) -> None:
    for kind in ("fmu", "direct"):
        extra = ["--direct"] * (kind == "direct")
        code, out, _ = command(
            "run", "pendulum", "--solver=adams", "--stop-time=0.2", "-o", str(tmp_path / kind), *extra
        )
        assert code == 0
    folders = {kind: tmp_path / kind / "pendulum" / "default-adams-1e-6" for kind in ("fmu", "direct")}
    through_fmu, direct = (Motion.load(folders[kind] / "motion.npz") for kind in ("fmu", "direct"))
    assert np.array_equal(through_fmu.r, direct.r)
    code, out, _ = command("view", str(folders["fmu"] / "motion.npz"))
    assert code == 0
    assert (folders["fmu"] / "motion.html").stat().st_size > 30_000
    assert "motion.html" in out


def test_two_runs_stand_in_one_page(command: Command, tmp_path: Path) -> None:
    path = tmp_path / "two.html"
    code, _, err = command(
        "view", "fourbar", "--solver=adams", "--stop-time=0.1", "--against=ida:1e-4", "-o", str(path)
    )
    assert (code, err) == (0, "")
    page = path.read_text()
    scene = scene_in(page)
    assert scene["title"] == "fourbar/default, adams, tolerance 1e-6"
    assert scene["against"]["title"] == "fourbar/default, ida, tolerance 1e-4"
    assert scene["against"]["picture"] == scene["picture"]
    first, second = (embedded(page, f"positions{end}", "<f4") for end in ("", "-against"))
    assert np.abs(first - second).max() > 0.0
    assert first == pytest.approx(second, abs=1e-2)
    assert scene["against"]["outputs"][0]["name"] == "crank.angle"


def test_pose_files_stand_against_each_other_and_keep_their_outputs(command: Command, tmp_path: Path) -> None:
    for mass in (1.0, 2.0):
        recorded(FourBar(crank_mass=mass), 0.1)[1].save(tmp_path / f"{mass:g}.npz")
    code, _, _ = command("view", str(tmp_path / "1.npz"), "--against", str(tmp_path / "2.npz"))
    assert code == 0
    page = (tmp_path / "1.html").read_text()
    outputs, energy = embedded(page, "outputs", "<f4"), [o["name"] for o in scene_in(page)["outputs"]].index("energy")
    assert np.abs(outputs[:, energy]).max() < 1e-4  # what it strays from its start
    base = scene_in(page)["outputs"][energy]["base"]
    assert base == Motion.load(tmp_path / "1.npz").values[0, energy]
    assert scene_in(page)["against"]["outputs"][energy]["base"] != base


def test_view_in_one_call_takes_a_second_run(tmp_path: Path) -> None:
    page = view(FourBar(), tmp_path / "a.html", 0.05, against=":1e-3").read_text()
    assert scene_in(page)["against"]["title"] == "fourbar, ida, tolerance 1e-3"
    _, motion = recorded(FourBar(), 0.05)
    page = view(motion, tmp_path / "b.html", against=recorded(Governor(), 0.05)[1]).read_text()
    assert scene_in(page)["against"]["bodies"][1] == "spindle"
    with pytest.raises(UserError, match="against is 'adams', but 'fourbar' is the record of a run"):
        view(motion, tmp_path / "c.html", against="adams")


def test_long_run_of_an_fmu_is_not_repeated(command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbfmu.cli.run.MAX_REPEATED_RUN_TIME", 0.0)
    code, out, _ = command("run", "pendulum", "--solver=adams", "--stop-time=0.1", "-o", str(tmp_path))
    assert code == 0
    assert "`mbfmu view pendulum`" in out
    folder = tmp_path / "pendulum" / "default-adams-1e-6"
    assert (folder / "outputs.csv").is_file()
    assert not (folder / "motion.npz").exists()


def test_view_runs_a_scene_itself(command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, _ = command("view", "governor/damped", "--solver=adams", "--stop-time=0.1", "--interval=0.05")
    assert code == 0
    page = (tmp_path / "results" / "governor" / "damped-adams-1e-6.html").read_text()
    assert embedded(page, "times", "<f8").ravel().tolist() == [0.0, 0.05, 0.1]


def test_page_needs_nothing_but_itself() -> None:
    _, motion = flat_sheet()
    page, stride = html.page(motion)
    assert stride == 1
    page = re.sub(r"/\*!.*?\*/", "", page, flags=re.DOTALL)  # whose the plots are, and their license
    assert not re.search(r"https?:|\bsrc\s*=|<link|@import|url\(|fetch\(|XMLHttpRequest|\{\{", page)
    assert "<title>a &lt;b&gt;</title>" in page
    assert scene_in(page)["bodies"] == list(motion.names)


def test_page_holds_the_poses() -> None:
    _, motion = recorded(Governor(), 0.1)
    page, _ = html.page(motion)
    assert np.array_equal(embedded(page, "times", "<f8").ravel(), motion.times)
    assert np.array_equal(embedded(page, "positions", "<f4").reshape(motion.r.shape), motion.r)
    turning = html.turning_bodies(motion)
    shown = embedded(page, "quaternions", "<f4").reshape(len(motion.times), len(turning), 4)
    assert np.array_equal(shown, motion.e[:, turning])
    _, motion = recorded(FourBar(coupler_modes=2), 0.1)
    page, _ = html.page(motion)
    assert np.array_equal(embedded(page, "amplitudes", "<f4").reshape(-1, 2), motion.p)
    assert motion.picture.bars[0].body in html.turning_bodies(motion)


def test_page_contains_the_scale_of_the_deflection() -> None:
    _, motion = recorded(FourBar(coupler_modes=2), 0.1)
    scene = scene_in(html.page(motion.scaled(10.0))[0])
    assert (scene["note"], scene["scale"]) == ("3 bodies · deflection × 10", 10.0)


def test_large_motion_is_thinned_to_its_last_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    _, motion = recorded(FourBar(), 0.5)
    monkeypatch.setattr(html, "MAX_PAGE_BYTES", 2_000)
    page, stride = html.page(motion)
    times = embedded(page, "times", "<f8").ravel()
    assert stride > 1
    assert times[0] == motion.times[0]
    assert times[1] == motion.times[stride]
    assert times[-1] == motion.times[-1]


def test_sheet_is_stored_and_drawn_as_one_skin(tmp_path: Path) -> None:
    mechanism, motion = flat_sheet()
    assert motion.picture.up == (0.0, 0.0, 1.0)
    assert not motion.picture.parts
    assert not motion.picture.links
    assert np.shape(motion.picture.skins[0].bodies) == (3, 4)
    assert html.turning_bodies(motion) == []  # positions alone
    images.write_png(motion, tmp_path / "sheet.png", 0.0, images.Shot(320, 240))
    assert len(np.unique(imread(tmp_path / "sheet.png").reshape(-1, 4), axis=0)) > 50
    with pytest.raises(UserError, match="surface 'torn' has rows of"):
        mechanism.surface("torn", [mechanism.bodies[1:4], mechanism.bodies[4:6]])


def test_sheet_of_an_assembly_has_a_surface_unless_it_is_given_one() -> None:
    for own in (False, True):
        m = Mechanism()
        sheet = add_sheet(
            m, "flag", length=0.3, width=0.2, thickness=1e-3, youngs_modulus=1e9, density=1000.0, grid=(4, 3),
            supports=[Support("x0", "clamped")],
        )  # fmt: skip
        if own:
            m.surface("mine", sheet.nodes, color="#102030")
        picture = draw(m, 0.3)
        (skin,) = picture.skins
        assert skin.name == ("mine" if own else "flag")
        assert skin.bodies == tuple(tuple(node.index for node in row) for row in sheet.nodes)
        assert {part.body for part in picture.parts} <= {0}
        assert not picture.links


@pytest.mark.parametrize("k", [1e-3, 1e3], ids=["millimeter", "kilometer"])
def test_page_suits_a_mechanism_of_any_size(k: float) -> None:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    arm = m.body("arm", m.ground, Revolute(start=0.3), **rod(mass=k**3, length=k))
    m.force("pull", PointForce(magnitude=k**3, at_a=(k, 0.0, 0.0)), arm)
    recorder = Recorder()
    simulate(m, 2.0 * k**0.5, interval=0.02 * k**0.5, watch=recorder)
    motion = recorder.motion("arm")
    scene = scene_in(html.page(motion)[0])
    value, length = scene["scales"]["N"]
    assert 0.01 < length / k < 1.0
    assert value / k**3 == pytest.approx(1.0, rel=0.6)
    assert scene["stage"]["half"][0] / k == pytest.approx(0.75, abs=0.35)
    assert np.linalg.norm(motion.picture.parts[0].axes[:3]) / k == pytest.approx(0.02, rel=0.7)


def test_page_of_the_fourbar_is_small(tmp_path: Path) -> None:
    _, motion = recorded(FourBar(), 10.0)
    assert html.write_html(motion, tmp_path / "page.html") == 1
    assert (tmp_path / "page.html").stat().st_size < 220_000


def test_png_gif_and_page_at_once(command: Command, tmp_path: Path) -> None:
    _, motion = recorded(Governor(), 0.2)
    motion.save(tmp_path / "g.npz")
    png, gif, page = (tmp_path / f"x.{kind}" for kind in ("png", "gif", "html"))
    code, out, err = command(
        "view", str(tmp_path / "g.npz"), "--png", str(png), "--time=0.1", "--gif", str(gif), "-o", str(page),
        "--size=320x240", "--fps=10", "--camera=-10,30",
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert all(str(path) in out for path in (png, gif, page))
    assert imread(png).shape == (240, 320, 4)
    assert len(np.unique(imread(png).reshape(-1, 4), axis=0)) > 200
    with Image.open(gif) as film:
        assert (film.size, film.n_frames) == ((320, 240), 3)
        assert film.info["duration"] == 100


def test_film_without_ffmpeg_reports_what_to_install(command: Command, tmp_path: Path, monkeypatch: Any) -> None:
    recorded(FourBar(), 0.05)[1].save(tmp_path / "f.npz")
    monkeypatch.setattr(images.FFMpegWriter, "isAvailable", lambda: False)
    code, _, err = command("view", str(tmp_path / "f.npz"), "--mp4", str(tmp_path / "f.mp4"))
    assert code == 2
    assert "ffmpeg, which is not installed" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("none.npz",), "pose file 'none.npz' cannot be read"),
        (("text.npz",), "'text.npz' is not a pose file"),
        (("other.npz",), "'other.npz' is not a pose file"),
        (("results.csv",), "unknown model 'results.csv'"),
        (("good.npz", "--png=x.png", "--time=9"), "time 9 s is outside the motion, 0 to 0.05 s"),
        (("good.npz", "--time=0"), "--time is given without --png"),
        (("good.npz", "--gif=x.png"), "must end in .gif"),
        (("good.npz", "-o", "x.png"), "must end in .html"),
        (("good.npz", "-o", "x.glb", "--open"), "--open requires an HTML page, but -o is x.glb"),
        (("good.npz", "-o", "x.glb", "--against=good.npz"), "--against requires an HTML page, but -o is x.glb"),
        (
            ("good.npz", "--against=good.npz", "--png=x.png"),
            "--against requires an HTML page: images and films show one run",
        ),
        (("good.npz", "--against=adams"), "--against 'adams': 'good.npz' is a recorded run; give another pose file"),
        (("good.npz", "--against=none.npz"), "pose file 'none.npz' cannot be read"),
        (("fourbar", "--against=ida"), "--against 'ida' is the run itself: ida, 1e-06"),
        (("fourbar", "--against=:1e-6"), "--against ':1e-6' is the run itself: ida, 1e-06"),
        (("fourbar", "--against=adam"), "solver is 'adam'; did you mean 'adams'?"),
        (
            ("fourbar", "--against=ida:fine"),
            "against is 'ida:fine', whose 'fine' is not a number; allowed: SOLVER",
        ),
        (("fourbar", "--against="), "against is ''; allowed: SOLVER, SOLVER:RTOL or :RTOL"),
        (("good.npz", "--gif=x.gif", "--fps=0"), "--fps is 0"),
        (("good.npz", "--gif=x.gif", "--speed=nan"), "--speed is nan"),
        (("good.npz", "--scale=0"), "--scale is 0.0; allowed: finite and greater than zero"),
        (("good.npz", "--scale=inf"), "--scale is inf; allowed: finite and greater than zero"),
        (("good.npz", "--scale=2"), "scale of the deflection is 2, but 'fourbar' has no flexible body"),
        (("good.npz", "--png=x.png", "--size=big"), "--size is 'big'"),
        (("good.npz", "--png=x.png", "--camera=1"), "--camera is '1'"),
        (("good.npz", "--png=no/folder/x.png"), "'no/folder/x.png' cannot be written"),
        (("good.npz", "--gif=no/folder/x.gif"), "'no/folder/x.gif' cannot be written"),
        (("good.npz", "--stop-time=1"), "--stop-time changes a run, but 'good.npz' is a recorded one"),
    ],
)
def test_mistakes_are_named(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("text.npz").write_text("not an archive")
    np.savez("other.npz", A=np.eye(2))
    recorded(FourBar(), 0.05)[1].save(Path("good.npz"))
    code, _, err = command("view", *arguments)
    assert code == 2
    assert message in err
    assert "Traceback" not in err


def test_readouts_are_read_out_in_pictures_and_kept_in_pose_files(tmp_path: Path) -> None:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    arm = m.body("arm", m.ground, Revolute(start=0.3), **rod(mass=1.0, length=1.0))
    m.output("angle", arm.angle())
    m.output("share", arm.direction("x", "x"))
    with pytest.raises(UserError, match="show_outputs is given 'angel', which is not an output of this mechanism"):
        m.show_outputs("angel")
    m.show_outputs("angle", "share", "angle")
    recorder = Recorder()
    simulate(m, 0.2, interval=0.1, watch=recorder)
    motion = recorder.motion("arm")
    assert motion.reading(0) == f"angle 0.3 rad\nshare {np.cos(0.3):.4g}"
    motion.save(tmp_path / "arm.npz")
    assert Motion.load(tmp_path / "arm.npz").picture.shown_outputs == ("angle", "share")
    shots = []
    for told in (motion, replace(motion, picture=replace(motion.picture, shown_outputs=()))):
        images.write_png(told, tmp_path / "arm.png", 0.0, images.Shot(320, 240))
        shots.append(imread(tmp_path / "arm.png"))
    rows = np.nonzero((shots[0] != shots[1]).any(axis=(1, 2)))[0]
    assert 20 < rows.min() < rows.max() < 90  # below the title
    lost = replace(motion, outputs=(("turn", "rad"), *motion.outputs[1:]))
    lost.save(tmp_path / "lost.npz")
    with pytest.raises(UserError, match="pose file of another version"):
        Motion.load(tmp_path / "lost.npz")


def test_view_sets_what_its_model_shows_unless_given_otherwise() -> None:
    def found(*arguments: str) -> str:
        options = parser().parse_args(["view", *arguments])
        return str(with_view_settings(scene_of(options), options).model.field)  # type: ignore[attr-defined]

    assert found("feeder") == found("feeder/skew") == "pressure"
    assert found("feeder", "--set", "field=none") == "none"
    assert found("sheet") == "none"
    assert found("sheet", "--set", "field=moment.xx") == "moment.xx"


def test_page_of_the_docs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[2] / "docs" / "viewing.md").read_text()
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```(\w+)\n(.*?)```", page, flags=re.DOTALL)
    commands = [line for language, text in blocks if language == "bash" for line in text.splitlines()]
    assert len(commands) == 13
    for line in commands:
        parser().parse_args(shlex.split(line)[1:])
    for language, text in blocks:
        if language == "python":
            exec(compile(text, "docs/viewing.md", "exec"), {})
    assert (tmp_path / "governor.html").is_file()


def browser() -> str | None:
    named = os.environ.get("MBFMU_BROWSER")
    return named or next(filter(None, map(shutil.which, BROWSERS)), None)


def opened(page: Path, *more: str) -> str:
    """What a browser prints of a page, opened with options of its command."""
    options = ["--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    options += ["--window-size=640,480", "--hide-scrollbars", "--virtual-time-budget=2000"]
    own = f"--user-data-dir={page.parent}/profile"
    command = [str(browser()), *options, own, *more, page.as_uri()]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout


@pytest.mark.skipif(browser() is None, reason="no Chromium here; MBFMU_BROWSER may name one")
def test_line_of_the_clock_stays_where_it_is_as_axes_get_wider(tmp_path: Path) -> None:
    """An output of a second unit brings an axis; the page stands still, and nothing else draws it again."""
    _, motion = recorded(FourBar(), 0.3)
    motion = replace(motion, picture=replace(motion.picture, shown_outputs=("crank.angle",)))
    page = tmp_path / "page.html"
    html.write_html(motion, page)
    told = """(viewer) => {
      viewer.halt(0.2);
      setTimeout(() => viewer.plot.toggle("energy"), 300);
      setTimeout(() => {
        const { plot } = viewer.plot, line = viewer.plot.now.style.transform.match(/[\\d.]+/)[0];
        document.body.dataset.line = line - plot.valToPos(0.2, "x");
      }, 600);
    }"""
    page.write_text(page.read_text().replace("start().catch(", f"start().then({told}).catch(", 1))
    content = opened(page, "--dump-dom", "--window-size=1200,700")
    off = re.search(r'data-line="([^"]*)"', content)
    assert off is not None
    assert float(off[1]) == pytest.approx(0.0, abs=0.01)
    angle = np.interp(0.2, motion.times, motion.values[:, [name for name, _ in motion.outputs].index("crank.angle")])
    assert f"<i>crank.angle</i><output>{angle:.4g} rad</output>" in content


@pytest.mark.skipif(browser() is None, reason="no Chromium here; MBFMU_BROWSER may name one")
@pytest.mark.parametrize("model", [Governor(), FourBar(coupler_modes=2)], ids=["governor", "elastic"])
def test_page_draws_in_a_browser(tmp_path: Path, model: Model) -> None:
    _, motion = recorded(model, 0.3)
    page, picture = tmp_path / "page.html", tmp_path / "page.png"
    html.write_html(motion, page)
    content = opened(page, "--dump-dom")
    assert 'data-state="ready"' in content
    assert "/ 0.30 s" in content
    opened(page, f"--screenshot={picture}")
    pixels = imread(picture)[60:400, 100:440, :3]
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 300
