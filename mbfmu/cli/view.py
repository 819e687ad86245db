"""``mbfmu view``."""

from __future__ import annotations

import argparse
import re
import sys
import webbrowser
from math import isfinite
from pathlib import Path

from tqdm import tqdm

from mbfmu.mechanics.numbers import positive
from mbfmu.modeling.parameters import declared
from mbfmu.modeling.scene import Scene
from mbfmu.modeling.settings import Settings
from mbfmu.session.run import Result, communication_points, run
from mbfmu.util.diagnostics import render
from mbfmu.util.errors import UserError
from mbfmu.viewer import Motion, Recorder
from mbfmu.viewer.gltf import write_glb
from mbfmu.viewer.html import write_html
from mbfmu.viewer.show import changes, side_by_side

from .common import (
    RESULTS_FOLDER,
    Commands,
    add_input,
    add_set,
    add_solver,
    assignments,
    file_stem,
    folder,
    number,
    print_inputs,
    print_paths,
    progress,
    scene_of,
)
from .completion import complete, motion_names

SCENE_OPTIONS = ("set", "input", *(setting.name for setting in declared(Settings)), "stop_time", "interval")


VIEW_EXAMPLES = """examples:
  mbfmu view governor/damped
  mbfmu view fourbar --against ida:1e-4 --open
  mbfmu view pendulum --png pendulum.png --time 0.4
  mbfmu view governor -o governor.glb
"""


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu view``."""
    p = commands.add_parser(
        "view",
        help=about,
        description="Write an animation of a run as one HTML file, which needs no network. The argument is a "
        "pose file motion.npz of `mbfmu run`, or a scene or model, which is then simulated directly.",
        epilog=VIEW_EXAMPLES,
    )
    given = p.add_argument(
        "scene", metavar="result", help="pose file .npz, scene file, model name, model/scene, or my_model.py:MyModel"
    )
    complete(given, motion_names)
    p.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="HTML file, or .glb for binary glTF (default: a page in results/ or next to the pose file, unless "
        "pictures are requested)",
    )
    p.add_argument(
        "--against",
        metavar="SOLVER[:RTOL]",
        help="second run, shown translucent: another solver, another tolerance (:1e-4), both (ida:1e-4), or a "
        "pose file .npz",
    )
    p.add_argument(
        "--scale", type=float, default=1.0, metavar="F", help="scale of the deflection of flexible bodies (default 1)"
    )
    p.add_argument("--open", action="store_true", help="open the page in the browser")
    p.add_argument("--png", type=Path, metavar="FILE", help="write an image")
    p.add_argument("--time", type=float, metavar="S", help="time of the image, s (default: the start)")
    p.add_argument("--gif", type=Path, metavar="FILE", help="write a GIF")
    p.add_argument("--mp4", type=Path, metavar="FILE", help="write an MP4 film; needs ffmpeg")
    p.add_argument("--fps", type=int, default=25, metavar="N", help="frames per second of GIF and MP4 (default 25)")
    p.add_argument(
        "--speed", type=float, default=1.0, metavar="X", help="speed of GIF and MP4 relative to real time (default 1)"
    )
    p.add_argument(
        "--size", default="960x720", metavar="WxH", help="size of images and films in pixels (default 960x720)"
    )
    p.add_argument(
        "--camera",
        metavar="AZIMUTH,ELEVATION",
        help="view direction of images and films in degrees, as in --camera=-30,20 (default: chosen from the motion)",
    )
    add_set(p)
    add_input(p)
    add_solver(p)
    p.add_argument("--stop-time", type=float, metavar="S", help="stop time, s")
    p.add_argument("--interval", type=float, metavar="S", help="time between frames, s")
    p.set_defaults(command=command_view)


def command_view(options: argparse.Namespace) -> int:
    """Write a page, or the requested pictures."""
    check(options)
    motion, against, results, page = load(options)
    if options.scale != 1.0:
        motion = motion.scaled(options.scale)
    written = write_pictures(motion, options)
    if options.output or options.open or not written:
        written.append(write_page(motion, against, options, options.output or page))
    print_paths(options, *written)
    for result in results:
        for line in render(result.problems):
            print(f"mbfmu: {line}", file=sys.stderr)
    return 1 if any(result.failed or result.inaccurate for result in results) else 0


def check(options: argparse.Namespace) -> None:
    """Complain about options before anything is run."""
    for name in ("fps", "speed", "scale"):
        positive(f"--{name}", getattr(options, name))
    if options.time is not None and not options.png:
        raise UserError("--time is given without --png; add --png FILE, the picture to write")
    for kind in ("png", "gif", "mp4"):
        path = getattr(options, kind)
        if path and path.suffix != f".{kind}":
            raise UserError(f"--{kind} {str(path)!r}: the file's name must end in .{kind}")
    if options.output and options.output.suffix not in (".html", ".htm", ".glb"):
        raise UserError(
            f"-o {str(options.output)!r}: the file's name must end in .html, or .glb for a glTF; pictures: --png, "
            "--gif, --mp4"
        )
    pictures = options.png or options.gif or options.mp4
    if options.against is not None and pictures and not (options.output or options.open):
        raise UserError("--against requires an HTML page: images and films show one run; add -o FILE.html")
    if options.output and options.output.suffix == ".glb" and (options.open or options.against is not None):
        given = "open" if options.open else "against"
        raise UserError(f"--{given} requires an HTML page, but -o is {options.output}; write a file .html")


def load(options: argparse.Namespace) -> tuple[Motion, Motion | None, list[Result], Path]:
    """Return the motion, the second motion, the results of the runs, and the path of the page."""
    source, against = Path(options.scene), options.against
    if source.suffix == ".npz":
        given = [name for name in SCENE_OPTIONS if getattr(options, name) not in (None, [])]
        if given:
            raise UserError(
                f"--{given[0].replace('_', '-')} changes a run, but {options.scene!r} is a recorded one; give a "
                "scene, or "
                "leave the option out"
            )
        if against is not None and not against.endswith(".npz"):
            raise UserError(f"--against {against!r}: {options.scene!r} is a recorded run; give another pose file, .npz")
        beside = Motion.load(Path(against)) if against is not None else None
        return Motion.load(source), beside, [], source.with_suffix(".html")
    scene = with_view_settings(scene_of(options), options)
    page = RESULTS_FOLDER / f"{file_stem(scene, options.set)}.html"
    recorded = Motion.load(Path(against)) if against is not None and against.endswith(".npz") else None
    other = against_of(scene, against) if against is not None and recorded is None else None
    print_inputs(options, scene)
    motion, result = recorded_run(scene)
    if other is None:
        return motion, recorded, [result], page
    beside, second = recorded_run(other)
    motion, beside = side_by_side(motion, result, beside, second)
    return motion, beside, [result, second], page


def with_view_settings(scene: Scene, options: argparse.Namespace) -> Scene:
    """Return the scene with what its model sets for viewing, but for what the scene or the command line has set."""
    given, model = assignments("--set", options.set), scene.model
    free = {p.name for p in model.parameters() if p.name not in given and getattr(model, p.name) == p.default}
    return scene.changed(model=model.with_values({k: v for k, v in model.viewing.items() if k in free}))


def against_of(scene: Scene, text: str) -> Scene:
    """Return the scene with the solver, the tolerance or both of ``SOLVER:RTOL``."""
    other = scene.changed(**changes(text))
    if other.settings == scene.settings:
        raise UserError(
            f"--against {text!r} is the run itself: {scene.settings.solver}, {scene.settings.tolerance:g}; give "
            "another "
            "solver or tolerance"
        )
    return other


def recorded_run(scene: Scene) -> tuple[Motion, Result]:
    """Run a scene directly; return its motion and its result."""
    recorder = Recorder()
    with progress(scene) as bar:
        times = communication_points(scene.stop_time, scene.output_interval)
        result = run(scene.model, scene.settings, times, bar, recorder)
    result.name = scene.name
    return recorder.motion(scene.name), result


def write_page(motion: Motion, against: Motion | None, options: argparse.Namespace, path: Path) -> Path:
    """Write the page, and open it on request; or the glTF file."""
    folder(path.parent)
    stride = write_glb(motion, path) if path.suffix == ".glb" else write_html(motion, path, against)
    if stride > 1 and not options.quiet:
        print(f"{path} shows one frame in {stride} of {len(motion.times)}, to limit its size")
    if options.open:
        webbrowser.open(path.resolve().as_uri())
    return path


def write_pictures(motion: Motion, options: argparse.Namespace) -> list[Path]:
    """Write the requested pictures and films."""
    if not (options.png or options.gif or options.mp4):
        return []
    from mbfmu.viewer.images import Shot, film_times, write_film, write_png

    shot = Shot(*size(options.size), *angles(options.camera))
    if options.png:
        write_png(motion, options.png, motion.times[0] if options.time is None else options.time, shot)
    for path in filter(None, (options.gif, options.mp4)):
        total = len(film_times(motion, options.fps, options.speed))
        with tqdm(total=total, desc=path.name, leave=False, disable=not sys.stderr.isatty()) as bar:
            write_film(motion, path, shot, options.fps, options.speed, bar.update)
    return [path for path in (options.png, options.gif, options.mp4) if path]


def size(text: str) -> tuple[int, int]:
    """Read ``WIDTHxHEIGHT``; even numbers, which films need."""
    match = re.fullmatch(r"(\d{2,4})x(\d{2,4})", text)
    if not match:
        raise UserError(f"--size is {text!r}; allowed: WIDTHxHEIGHT in pixels, 10 to 9999 each, such as 1280x720")
    return int(match[1]) // 2 * 2, int(match[2]) // 2 * 2


def angles(text: str | None) -> tuple[float | None, float | None]:
    """Read ``AZIMUTH,ELEVATION``."""
    if text is None:
        return None, None
    parts = [number("--camera", part) for part in text.split(",")]
    if len(parts) != 2 or not all(map(isfinite, parts)):
        raise UserError(f"--camera is {text!r}; allowed: AZIMUTH,ELEVATION in degrees, such as 30,20")
    return parts[0], parts[1]
