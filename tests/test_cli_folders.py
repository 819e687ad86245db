"""Folders of results: names, processes that share them, what is left behind."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier
from typing import Any

import pytest

from mbfmu.cli.results import results
from mbfmu.modeling.scene import load_scene

Command = Callable[..., Any]


def folders(place: Path) -> list[str]:
    """Return the names of all that is in a folder, hidden or not."""
    return sorted(path.name for path in place.iterdir())


def test_a_run_again_leaves_the_first_alone(command: Command, tmp_path: Path) -> None:
    told = ("run", "fourbar/paper", "--direct", "--stop-time=0.1", "--plot=energy", "-o", str(tmp_path))
    first = tmp_path / "fourbar" / "paper-hybrid-1e-4"
    assert command(*told)[0] == 0
    before = {path.name: path.read_bytes() for path in first.iterdir()}
    assert command(*told)[0] == 0
    assert folders(tmp_path / "fourbar") == ["paper-hybrid-1e-4", "paper-hybrid-1e-4-2"]
    assert {path.name: path.read_bytes() for path in first.iterdir()} == before


def test_the_scene_in_a_folder_runs_the_same_again(command: Command, tmp_path: Path) -> None:
    told = ("--direct", "--stop-time=0.1", "--plot=energy", "-q", "-o", str(tmp_path))
    _, first, _ = command("run", "fourbar/paper", "--set=crank_mass=2", "--max-order=3", *told)
    again = load_scene(str(Path(first.strip()) / "paper.toml"))
    assert again.settings == replace(load_scene("fourbar/paper").settings, max_order=3)
    assert (again.name, again.stop_time, again.model.crank_mass) == ("fourbar/paper", 0.1, 2.0)  # type: ignore[attr-defined]
    _, second, _ = command("run", str(Path(first.strip()) / "paper.toml"), *told)
    assert second == first.replace("-crank_mass=2", "")  # only `--set` is part of the name
    numbers = [(Path(folder.strip()) / "outputs.csv").read_text() for folder in (first, second)]
    assert numbers[0] == numbers[1]


def test_processes_that_end_at_once_do_not_meet(tmp_path: Path) -> None:
    def write(number: int) -> str:
        with results(tmp_path, load_scene("fourbar"), "x") as place:
            place.file("who").write_text(str(number))
            start.wait()
            return (place.keep() / "who").read_text()

    start = Barrier(8)
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(write, range(8))) == [str(number) for number in range(8)]
    assert folders(tmp_path / "fourbar") == ["x", *(f"x-{number}" for number in range(2, 9))]


@pytest.mark.parametrize("extra", [(), ("--direct",)])
def test_an_interrupted_run_leaves_nothing_behind(tmp_path: Path, extra: tuple[str, ...]) -> None:
    """Ctrl-C after a second of a run that would take long."""
    told = ("run", "pendulum", "--stop-time=1e5", "--interval=1", "--max-steps=1000000000", "-o", str(tmp_path))
    process = subprocess.Popen(
        (sys.executable, "-m", "mbfmu", *told, *extra), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        while process.poll() is None and not (tmp_path / "pendulum").is_dir():
            time.sleep(0.1)
        time.sleep(3.0)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (process.returncode, out) == (130, "")
    assert "mbfmu: interrupted" in err
    assert "Traceback" not in err
    assert folders(tmp_path) == []


@pytest.mark.parametrize("there", [False, True])
def test_folders_made_for_what_was_not_kept_are_removed(tmp_path: Path, there: bool) -> None:
    root = tmp_path / "deep" / "results"
    if there:
        root.mkdir(parents=True)
    with pytest.raises(KeyboardInterrupt), results(root, load_scene("fourbar"), "x"):
        raise KeyboardInterrupt
    assert root.is_dir() == there
    assert (tmp_path / "deep").is_dir() == there
    assert not (root / "fourbar").exists()


@pytest.mark.parametrize("way", ["root", "model", "above"])
def test_a_file_in_the_place_of_a_folder_is_reported_before_the_run(command: Command, tmp_path: Path, way: str) -> None:
    root = {"root": tmp_path / "file", "model": tmp_path, "above": tmp_path / "file" / "results"}[way]
    (tmp_path / ("fourbar" if way == "model" else "file")).write_text("kept")
    code, out, err = command("run", "fourbar", "-o", str(root))
    assert (code, out) == (2, "")
    assert err.startswith("mbfmu: folder ")
    assert "cannot be created" in err


def test_a_folder_that_is_read_only_is_reported_before_the_run(command: Command) -> None:
    code, out, err = command("run", "fourbar", "-o", "/proc/results")
    assert (code, out) == (2, "")
    assert err == "mbfmu: folder '/proc/results/fourbar' cannot be created: No such file or directory [file-access]\n"


def test_names_with_spaces_and_slashes_are_folders(command: Command, tmp_path: Path) -> None:
    place = tmp_path / "my models"
    place.mkdir()
    source = place / "my model.py"
    source.write_text("from fmus.fourbar import FourBar\nclass Mine(FourBar):\n    name = 'crank / rocker'\n")
    (place / "a scene.toml").write_text('model = "my model.py:Mine"\nstop_time = 0.02\n')
    root = tmp_path / "my results"
    for told in ((f"{source}:Mine", "--stop-time=0.02"), (str(place / "a scene.toml"),)):
        assert command("run", *told, "--direct", "--plot=energy", "-o", str(root))[0] == 0
    assert folders(root) == ["crank _ rocker"]
    assert folders(root / "crank _ rocker") == ["a scene-ida-1e-6", "default-ida-1e-6"]
    saved = root / "crank _ rocker" / "a scene-ida-1e-6" / "a scene.toml"
    assert load_scene(str(saved)).model.name == "crank / rocker"


def test_two_models_of_one_file_and_two_solvers_keep_their_results(command: Command, tmp_path: Path) -> None:
    source = tmp_path / "two.py"
    model = "class {}(FourBar):\n    pass\n"
    source.write_text("from fmus.fourbar import FourBar\n" + model.format("First") + model.format("Second"))
    for name, solver in (("First", "adams"), ("Second", "adams"), ("Second", "ida")):
        told = (f"{source}:{name}", f"--solver={solver}", "--direct", "--stop-time=0.02", "--plot=energy")
        assert command("run", *told, "-o", str(tmp_path))[0] == 0
    assert folders(tmp_path / "first") == ["default-adams-1e-6"]
    assert folders(tmp_path / "second") == ["default-adams-1e-6", "default-ida-1e-6"]
