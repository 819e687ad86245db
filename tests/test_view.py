"""Recorded motions, the page, pictures and films."""

from __future__ import annotations

import base64
import json
import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from PIL import Image
from scipy.spatial.transform import Rotation

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.cli import parser
from mbfmu.errors import UserError
from mbfmu.mechanics import (
    Beam,
    Box,
    Cylinder,
    Floating,
    Mechanism,
    Polynomial,
    Revolute,
    Sphere,
    Spherical,
    SphericalCut,
    Spring,
    Translational,
    rod,
)
from mbfmu.model import Model
from mbfmu.simulation import Result, Settings, communication_points, run
from mbfmu.view import Motion, Recorder, html, images
from mbfmu.view.camera import Camera, Stage
from mbfmu.view.motion import matrices
from mbfmu.view.picture import draw

Command = Callable[..., Any]

BROWSERS = ("chromium", "chromium-browser", "chromium-headless-shell", "google-chrome", "chrome")


def recorded(model: Model, stop: float = 0.5) -> tuple[Result, Motion]:
    recorder = Recorder()
    result = run(model, Settings(solver="adams"), communication_points(stop, 0.01), watch=recorder)
    assert not result.failure
    return result, recorder.motion(model.name)


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
        r=r,
        e=e,
        p=np.zeros((2, 0), np.float32),
        picture=draw(m, 0.4),
    )
    return m, motion


def embedded(page: str, name: str, kind: str) -> np.ndarray[Any, Any]:
    block = re.search(rf'<script type="application/octet-stream" id="{name}">(.*?)</script>', page)
    assert block is not None
    return np.frombuffer(base64.b64decode(block[1]), kind)


def scene_in(page: str) -> dict[str, Any]:
    block = re.search(r'id="scene">(.*?)</script>', page)
    assert block is not None
    scene: dict[str, Any] = json.loads(block[1])
    return scene


class Arm(Model):
    """A heavy cantilever that turns, bends and is shortened by it."""

    name = "arm"

    def build(self) -> Mechanism:
        beam = Beam(length=2.0, mass=1.0, bending_stiffness=20.0, modes=2, ends=("clamped", "free"), stiffening=True)
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        arm = m.elastic("arm", m.ground, Revolute(drive=Polynomial((0.3, 2.0))), beam)
        m.output("tip.deflection", arm.deflection(2.0))
        return m


def test_poses_are_those_of_the_kinematics() -> None:
    result, motion = recorded(Governor(damping=100.0))
    assert np.array_equal(motion.times, result.times)
    collar, arm = motion.names.index("collar"), motion.names.index("arm2")
    assert motion.r[:, collar, 1] == pytest.approx(result["collar.height"], abs=1e-7)
    ball = motion.point(arm, (0.16, 0.0, 0.0))[:, 0]
    assert ball[:, 1] == pytest.approx(0.2 - 0.16 * np.sin(result["arm2.angle"]), abs=1e-6)
    spindle, angle = 0.16 * np.cos(result["arm2.angle"]), result["spindle.angle"]
    assert ball[:, 0] == pytest.approx(spindle * np.cos(angle), abs=1e-6)
    assert ball[:, 2] == pytest.approx(-spindle * np.sin(angle), abs=1e-6)


def test_point_off_the_origin_agrees_with_a_sensor() -> None:
    result, motion = recorded(FourBar())
    middle = motion.point(motion.names.index("coupler"), (1.5, 0.0, 0.0))[:, 0]
    assert middle[:, 0] == pytest.approx(result["coupler.position.x"], abs=1e-6)
    assert middle[:, 1] == pytest.approx(result["coupler.position.y"], abs=1e-6)


def test_bar_passes_through_the_sections_of_an_elastic_body() -> None:
    result, motion = recorded(FourBar(coupler_modes=2))
    (bar,) = motion.picture.bars
    axis = motion.axis(bar)
    middle = len(bar.x) // 2
    assert bar.x[middle] == pytest.approx(1.5)
    assert axis[:, middle, 0] == pytest.approx(result["coupler.position.x"], abs=1e-6)
    assert axis[:, middle, 1] == pytest.approx(result["coupler.position.y"], abs=1e-6)
    assert axis[:, -1] == pytest.approx(motion.r[:, motion.names.index("coupler[3]")], abs=1e-6)


def test_bar_is_shortened_by_bending() -> None:
    _, motion = recorded(Arm())
    (bar,) = motion.picture.bars
    assert np.abs(motion.p).max() > 0.1
    assert motion.axis(bar)[:, -1] == pytest.approx(motion.r[:, motion.names.index("arm[2]")], abs=1e-6)
    small = bar.axis(np.array([0.02, 0.005]), 1.0)
    length = np.linalg.norm(np.diff(small, axis=0), axis=1).sum()
    assert length == pytest.approx(2.0, abs=1e-6)  # to second order in a slope of 0.03
    assert 2.0 - small[-1, 0] > small[-1, 1] ** 2 / 4.0 > 0.0  # a straight arm would be shortened least


def test_scale_magnifies_the_deflection_alone(tmp_path: Path) -> None:
    result, plain = recorded(FourBar(coupler_modes=2))
    motion = plain.scaled(10.0)
    (bar,) = motion.picture.bars
    axis = motion.axis(bar)
    assert axis[:, [0, -1]] == pytest.approx(plain.axis(bar)[:, [0, -1]], abs=1e-9)
    chord = (axis[:, -1] - axis[:, 0]) / 3.0
    away = axis[:, len(bar.x) // 2] - axis[:, 0]
    left = chord[:, 0] * away[:, 1] - chord[:, 1] * away[:, 0]
    assert np.abs(result["coupler.deflection"]).max() > 1e-3
    assert left == pytest.approx(10.0 * result["coupler.deflection"], abs=1e-6)
    assert (motion.caption, plain.caption) == ("deflection × 10", "")
    scene = scene_in(html.page(motion)[0])
    assert (scene["note"], scene["scale"]) == ("3 bodies · deflection × 10", 10.0)
    motion.save(tmp_path / "m.npz")
    assert Motion.load(tmp_path / "m.npz").scale == 1.0


def test_elastic_body_is_a_bar_and_its_sections_are_not_drawn() -> None:
    mechanism = FourBar(coupler_modes=2).build()
    picture = draw(mechanism, 3.0)
    (bar,) = picture.bars
    assert (bar.height, bar.width) == (0.03, 0.03)
    names = [body.name for body in mechanism.bodies]
    assert [names[i] for i in picture.unnamed] == ["coupler.mode", "coupler[1.5]", "coupler[3]"]
    drawn = {names[part.body] for part in picture.parts if part.solid != "cylinder"}
    assert drawn == {"ground", "crank", "rocker"}
    mechanism.profile(mechanism.elastics[0], height=0.1, width=0.2, colour="#102030")
    (bar,) = draw(mechanism, 3.0).bars
    assert (bar.height, bar.width, bar.colour) == (0.1, 0.2, "#102030")


def test_bad_profiles_are_named() -> None:
    mechanism = FourBar(coupler_modes=1).build()
    (coupler,) = mechanism.elastics
    with pytest.raises(UserError, match=r"height and width of the profile of 'coupler' is \(0.0, 0.1\) m; allowed"):
        mechanism.profile(coupler, height=0.0, width=0.1)
    with pytest.raises(UserError, match="colour is 'red'"):
        mechanism.profile(coupler, height=0.1, width=0.1, colour="red")
    with pytest.raises(UserError, match="elastic body of a profile is 'coupler'; it must be one of this mechanism"):
        FourBar(coupler_modes=1).build().profile(coupler, height=0.1, width=0.1)


def test_bent_bar_is_closed_and_faces_outward() -> None:
    angle = np.linspace(0.0, 1.0, 65)
    axis = 2.0 * np.stack((np.sin(angle), 1.0 - np.cos(angle), 0.0 * angle), axis=-1)
    faces = images.bent(axis, np.array([0.0, 0.0, 1.0]), 0.2, 0.3)
    normals = 0.5 * np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
    assert normals.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)
    volume = np.einsum("ij,ij->", faces.mean(axis=1), normals) / 3.0
    assert volume == pytest.approx(2.0 * 0.2 * 0.3, rel=1e-3)  # Pappus: length of the axis times the section


def test_watching_does_not_change_the_run() -> None:
    times = communication_points(0.3, 0.01)
    plain = run(FourBar(), Settings(), times)
    watched = run(FourBar(), Settings(), times, watch=Recorder())
    assert np.array_equal(plain.values, watched.values)


def test_matrices_of_quaternions() -> None:
    e = Rotation.random(20, random_state=0).as_quat()
    assert matrices(np.roll(e, 1, axis=-1)) == pytest.approx(Rotation.from_quat(e).as_matrix(), abs=1e-15)


def test_pose_file_keeps_everything(tmp_path: Path) -> None:
    _, motion = recorded(FourBar(coupler_modes=2), 0.1)
    motion.save(tmp_path / "m.npz")
    again = Motion.load(tmp_path / "m.npz")
    assert again.picture == motion.picture
    assert (again.title, again.names, again.parents) == (motion.title, motion.names, motion.parents)
    for name in ("times", "r", "e", "p"):
        assert np.array_equal(getattr(again, name), getattr(motion, name))


def test_pose_file_of_another_version_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "old.npz", about=json.dumps({"format": 1, "title": "old"}), times=np.zeros(1))
    with pytest.raises(UserError, match="is not a pose file this version of mbfmu can read"):
        Motion.load(tmp_path / "old.npz")


def test_run_then_view(command: Command, tmp_path: Path) -> None:
    for kind in ("fmu", "native"):
        extra = ["--native"] * (kind == "native")
        code, out, _ = command(
            "run", "pendulum", "--solver=adams", "--stop-time=0.2", "-o", str(tmp_path / kind), *extra
        )
        assert code == 0
        assert "pendulum.npz" in out
    through_fmu, native = (Motion.load(tmp_path / kind / "pendulum.npz") for kind in ("fmu", "native"))
    assert np.array_equal(through_fmu.r, native.r)
    code, out, _ = command("view", str(tmp_path / "fmu" / "pendulum.npz"))
    assert code == 0
    assert (tmp_path / "fmu" / "pendulum.html").stat().st_size > 30_000
    assert "pendulum.html" in out


def test_long_run_of_an_fmu_is_not_repeated(command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbfmu.cli.run.QUICK", 0.0)
    code, out, _ = command("run", "pendulum", "--solver=adams", "--stop-time=0.1", "-o", str(tmp_path))
    assert code == 0
    assert "`mbfmu view pendulum`" in out
    assert not (tmp_path / "pendulum.npz").exists()


def test_view_runs_a_scene_itself(command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, _ = command("view", "governor/damped", "--solver=adams", "--stop-time=0.1", "--interval=0.05")
    assert code == 0
    page = (tmp_path / "results" / "damped.html").read_text()
    assert len(embedded(page, "times", "<f8")) == 3


def test_page_needs_nothing_but_itself() -> None:
    _, motion = flat_sheet()
    page, stride = html.page(motion)
    assert stride == 1
    assert not re.search(r"https?:|\bsrc\s*=|<link|@import|url\(|fetch\(|XMLHttpRequest|\{\{", page)
    assert "<title>a &lt;b&gt;</title>" in page
    assert scene_in(page)["bodies"] == list(motion.names)


def test_page_holds_the_poses() -> None:
    _, motion = recorded(Governor(), 0.1)
    page, _ = html.page(motion)
    assert np.array_equal(embedded(page, "times", "<f8"), motion.times)
    assert np.array_equal(embedded(page, "positions", "<f4").reshape(motion.r.shape), motion.r)
    turning = html.turning_bodies(motion)
    shown = embedded(page, "quaternions", "<f4").reshape(len(motion.times), len(turning), 4)
    assert np.array_equal(shown, motion.e[:, turning])
    _, motion = recorded(FourBar(coupler_modes=2), 0.1)
    page, _ = html.page(motion)
    assert np.array_equal(embedded(page, "amplitudes", "<f4").reshape(-1, 2), motion.p)
    assert motion.picture.bars[0].body in html.turning_bodies(motion)


def test_large_motion_is_thinned_to_its_last_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    _, motion = recorded(FourBar(), 0.5)
    monkeypatch.setattr(html, "LARGEST", 2_000)
    page, stride = html.page(motion)
    times = embedded(page, "times", "<f8")
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
    with pytest.raises(UserError, match="surface 'torn' needs at least 2 rows"):
        mechanism.surface("torn", [mechanism.bodies[1:4], mechanism.bodies[4:6]])


def test_default_picture_knows_every_joint_cut_and_spring() -> None:
    m = Mechanism()
    arm = m.body("arm", m.ground, Revolute(), **rod(mass=1.0, length=1.0))
    hung = m.body("hung", arm, Spherical(at=(1.0, 0.0, 0.0)), **rod(mass=1.0, length=0.5))
    slider = m.body("slider", m.ground, Translational(axis="x", start=0.3), mass=2.0)
    free = m.body("free", m.ground, Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    m.cut("ball", SphericalCut(at_a=(0.5, 0.0, 0.0)), hung, slider)
    m.force("spring", Spring(stiffness=1.0), slider, free)
    picture = draw(m, 2.0)
    assert {part.body for part in picture.parts} == {0, arm.index, hung.index, slider.index, free.index}
    assert sorted(link.solid for link in picture.links) == ["coil", "cylinder"]
    axes = [np.reshape(part.axes, (3, 3)) for part in picture.parts if part.body == arm.index]
    assert max(np.linalg.norm(bar[2]) for bar in axes) == pytest.approx(1.0)  # the bar, as long as the arm
    assert len({part.colour for part in picture.parts}) >= 5


def test_shapes_replace_the_default_picture() -> None:
    m = Mechanism()
    body = m.body("body", m.ground, Floating(), mass=1.0)
    m.shape(
        body,
        Box(size=(0.1, 0.2, 0.3), at=(1.0, 0.0, 0.0), colour="#102030"),
        Cylinder(radius=0.1, length=2.0, axis="x"),
        Sphere(radius=0.5),
    )
    block, bar, ball = draw(m, 1.0).parts
    assert (block.at, block.colour) == ((1.0, 0.0, 0.0), "#102030")
    assert np.reshape(block.axes, (3, 3)) == pytest.approx(np.diag((0.1, 0.2, 0.3)))
    assert bar.axes[6:] == pytest.approx((2.0, 0.0, 0.0))
    assert np.linalg.det(np.reshape(bar.axes, (3, 3))) == pytest.approx(0.02)
    assert ball.colour == bar.colour != block.colour


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere(radius=-1.0), "radius of a sphere"),
        (lambda: Box(size=(1.0, 2.0)), "size of a box"),
        (lambda: Box(size=(1.0, 1.0, 1.0), rotation=np.ones((3, 3))), "rotation of a box"),
        (lambda: Cylinder(radius=1.0, length=1.0, axis="w"), "axis is 'w'"),
        (lambda: Sphere(radius=1.0, colour="red"), "colour is 'red'; write #rrggbb"),
        (lambda: Sphere(radius=1.0, at=(0.0, 0.0)), "at of a shape of body 'b'"),
        (lambda: "ball", "shape of body 'b' is 'ball'"),
    ],
)
def test_bad_shapes_are_named(make: Callable[[], Any], message: str) -> None:
    m = Mechanism()
    body = m.body("b", m.ground, Revolute(), mass=1.0)
    with pytest.raises(UserError, match=re.escape(message)):
        m.shape(body, make())


@pytest.mark.parametrize(
    "model",
    [FourBar(), FourBar(coupler_modes=2, youngs_modulus=5e9), Governor(), SwingPendulum()],
    ids=["fourbar", "elastic", "governor", "pendulum"],
)
@pytest.mark.parametrize("aspect", [0.5, 2.0])
def test_camera_sees_the_whole_motion(model: Model, aspect: float) -> None:
    _, motion = recorded(model)
    stage = Stage.of(motion)
    assert stage.axes == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    camera = Camera.looking_at(stage, aspect, stage.azimuth, stage.elevation)
    for body, at in motion.picture.points().items():
        seen, depth = camera.project(motion.point(body, at))
        assert np.all(depth > 0.0)
        assert np.all(np.abs(seen) <= (0.5 * aspect, 0.5))
    for bar in motion.picture.bars:
        assert np.all(np.abs(camera.project(motion.axis(bar))[0]) <= (0.5 * aspect, 0.5))


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


def test_film_without_ffmpeg_says_what_to_install(command: Command, tmp_path: Path, monkeypatch: Any) -> None:
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
        (("good.npz", "--time=0"), "--time goes with --png"),
        (("good.npz", "--gif=x.png"), "must end in .gif"),
        (("good.npz", "-o", "x.png"), "must end in .html"),
        (("good.npz", "--gif=x.gif", "--fps=0"), "--fps is 0"),
        (("good.npz", "--gif=x.gif", "--speed=nan"), "--speed is nan"),
        (("good.npz", "--scale=0"), "--scale is 0; allowed: finite and greater than zero"),
        (("good.npz", "--scale=inf"), "--scale is inf; allowed: finite and greater than zero"),
        (("good.npz", "--scale=2"), "scale of the deflection is 2, but 'fourbar' has no elastic body to bend"),
        (("good.npz", "--png=x.png", "--size=big"), "--size 'big'"),
        (("good.npz", "--png=x.png", "--camera=1"), "--camera '1'"),
        (("good.npz", "--png=no/folder/x.png"), "'no/folder/x.png' cannot be written"),
        (("good.npz", "--gif=no/folder/x.gif"), "'no/folder/x.gif' cannot be written"),
        (("good.npz", "--stop-time=1"), "--stop-time changes a run, and 'good.npz' is the record of one"),
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


def test_page_of_the_docs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[1] / "docs" / "viewing.md").read_text()
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```(\w+)\n(.*?)```", page, flags=re.DOTALL)
    commands = [line for language, text in blocks if language == "bash" for line in text.splitlines()]
    assert len(commands) == 8
    for line in commands:
        parser().parse_args(shlex.split(line)[1:])
    for language, text in blocks:
        if language == "python":
            exec(compile(text, "docs/viewing.md", "exec"), {})
    assert (tmp_path / "governor.html").is_file()


def browser() -> str | None:
    named = os.environ.get("MBFMU_BROWSER")
    return named or next(filter(None, map(shutil.which, BROWSERS)), None)


@pytest.mark.skipif(browser() is None, reason="no Chromium here; MBFMU_BROWSER may name one")
@pytest.mark.parametrize("model", [Governor(), FourBar(coupler_modes=2)], ids=["governor", "elastic"])
def test_page_draws_in_a_browser(tmp_path: Path, model: Model) -> None:
    _, motion = recorded(model, 0.3)
    page, picture = tmp_path / "page.html", tmp_path / "page.png"
    html.write_html(motion, page)
    options = ["--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    options += [
        "--window-size=640,480",
        "--hide-scrollbars",
        "--virtual-time-budget=2000",
        f"--user-data-dir={tmp_path}/p",
    ]

    def opened(*more: str) -> str:
        done = subprocess.run(
            [str(browser()), *options, *more, page.as_uri()], capture_output=True, text=True, timeout=120, check=True
        )
        return done.stdout

    content = opened("--dump-dom")
    assert 'data-state="ready"' in content
    assert "/ 0.30 s" in content
    opened(f"--screenshot={picture}")
    pixels = imread(picture)[60:400, 100:440, :3]
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 300
