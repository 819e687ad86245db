"""A scene: which model, with which numbers, integrated how, for how long. A TOML file, or a model's name alone.

model = "fourbar"          # registered name, or path/to/file.py:Class
solver = "adams"           # ida, adams, hybrid, radau, esdirk, auto
tolerance = 1e-6
absolute_tolerance = 0.0   # relative to the nominal values; 0: the relative one
max_step = 0.0             # s; 0: no limit
max_order = 0              # 0: the solver's own
max_steps = 100000         # between two outputs
input_interpolation = "hold"  # of loads that an importing tool sets: constant; or "linear": extrapolated
start_at_equilibrium = false
energy_check = true        # check of the energy balance during the run
stop_time = 10.0           # s
output_interval = 0.01     # s

[parameters]
start_angle = 0.1745

[inputs]                   # of a model that has them: number, expression of t (s), file, or points
force = "10 * sin(30 * t)"
"road.height" = "road.csv" # relative to the folder of the scene file

A scene is called ``model/scene``: ``fourbar/paper`` ships with the four-bar, ``fourbar/default`` is the model as it is.
"""

from __future__ import annotations

import inspect
import json
import sys
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import Any

from mbfmu.util.errors import RENAMED, UserError, suggest
from mbfmu.util.toml import read_toml

from .model import Model
from .parameters import declared
from .registry import at_defaults, find
from .replaced_inputs import check_end, entry_text, read_entry
from .settings import Settings

SETTING_NAMES = tuple(p.name for p in declared(Settings))
SCENE_KEYS = ("model", *SETTING_NAMES, "stop_time", "output_interval", "parameters", "inputs")
MAX_OUTPUTS = 1e7  # of a run
DEFAULT_SCENE = "default"  # the scene of a model as it is


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What ``mbfmu run`` runs.

    Parameters
    ----------
    name
        Model and scene, such as ``fourbar/paper``.
    settings
        With the solver and the tolerance of the model, where these are not given.
    stop_time, output_interval
        s, greater than zero.
    reference
        What :func:`mbfmu.modeling.registry.find` finds the model by; empty: nothing.
    """

    name: str
    model: Model
    settings: Settings
    stop_time: float
    output_interval: float
    reference: str = ""

    def __post_init__(self) -> None:
        """Check the times, and complete the settings; raises UserError."""
        check_times(self.stop_time, self.output_interval)
        object.__setattr__(self, "settings", self.settings.for_model(self.model))

    def changed(self, **changes: Any) -> Scene:
        """Return a copy with the given fields; None leaves one as it is."""
        settings = {k: changes.pop(k) for k in SETTING_NAMES if k in changes}
        given = {k: v for k, v in settings.items() if v is not None}
        rest = {k: v for k, v in changes.items() if v is not None}
        return replace(self, settings=replace(self.settings, **given), **rest)


def check_times(stop_time: Any, output_interval: Any) -> None:
    """Refuse what is no duration, and more outputs than can be kept; raises UserError."""
    for key, value in (("stop_time", stop_time), ("output_interval", output_interval)):
        number = not isinstance(value, bool) and isinstance(value, int | float)
        if not number or not 0.0 < value < inf or value > sys.float_info.max:
            raise UserError(f"{key} is {value!r}; allowed: a number of seconds greater than zero")
    if stop_time / output_interval > MAX_OUTPUTS:
        raise UserError(
            f"output_interval is {output_interval!r} s: allowed: at most ten million outputs. Use a larger interval"
        )


def load_scene(reference: str) -> Scene:
    """Return the scene of a TOML file, of a shipped scene ``model/scene``, or the default scene of a model.

    Raises
    ------
    UserError
        Names the file, the key, its value and what is allowed.
    """
    path = Path(reference)
    if path.suffix == ".toml" or ".py" in reference:
        check_text(str(path.absolute()))
    if path.suffix == ".toml":
        return read_scene(path)
    model, slash, scene = reference.partition("/")
    if not slash or ".py" in reference:
        return default_scene(at_defaults(find(reference)), absolute(reference))
    known = scenes(find(model))
    if scene not in known:
        raise UserError(f"model {model!r} has no scene {scene!r}{suggest(scene, known)}")
    shipped = known[scene]
    return read_scene(shipped) if shipped else default_scene(at_defaults(find(model)), model)


def check_text(path: str) -> None:
    """Refuse a path that is not valid UTF-8, which no scene and no FMU could name; raises UserError."""
    try:
        path.encode("utf-8")
    except UnicodeEncodeError as error:
        raise UserError(f"path {path!a} is not valid UTF-8; rename the file or its folder") from error


def default_scene(model: Model, reference: str = "") -> Scene:
    """Return a model's own scene."""
    return Scene(
        name=f"{model.name}/{DEFAULT_SCENE}",
        model=model,
        settings=Settings(),
        stop_time=model.stop_time,
        output_interval=model.output_interval,
        reference=reference,
    )


def scenes(model: type[Model]) -> dict[str, Path | None]:
    """Return the scenes of a model by name with their files: its own, which has none, then those that ship with it."""
    try:
        folder = Path(inspect.getfile(model)).parent / "scenes"
    except TypeError:  # a model in memory, such as an imported robot
        return {DEFAULT_SCENE: None}
    return {DEFAULT_SCENE: None} | {path.stem: path for path in sorted(folder.glob("*.toml"))}


def absolute(reference: str) -> str:
    """Return a model's reference as it is found from any folder."""
    return str(Path(reference).absolute()) if ".py" in reference else reference


def read_scene(path: Path) -> Scene:
    """Read a scene file."""
    content = read_toml(path, "scene file")
    for key in content:
        if key not in SCENE_KEYS:
            raise UserError(f"scene file {str(path)!r} has an unknown key {key!r}{suggest(key, SCENE_KEYS)}")
    try:
        return from_content(path, content)
    except UserError as error:
        raise UserError(f"scene file {str(path)!r}: {error}") from error


def from_content(path: Path, content: dict[str, Any]) -> Scene:
    """Build the scene from the keys of a file."""
    reference = content.pop("model", None)
    if not isinstance(reference, str):
        raise UserError(f"model is {reference!r}; allowed: a model's name, or a file my_model.py:MyModel")
    if ".py" in reference:  # in the folder of the scene
        reference = str(path.parent / reference)
    parameters = content.pop("parameters", {})
    if not isinstance(parameters, dict):
        raise UserError(f"parameters is {parameters!r}; allowed: a table [parameters]")
    model = at_defaults(find(reference)).with_values(parameters)
    inputs = content.pop("inputs", {})
    if not isinstance(inputs, dict):
        raise UserError(
            f"inputs is {inputs!r}; allowed: a table [inputs]; as a setting it is now called {RENAMED['inputs']!r}"
        )
    if inputs:
        model = model.with_inputs({name: read_entry(name, value, path.parent) for name, value in inputs.items()})
    scene = default_scene(model, absolute(reference)).changed(name=f"{model.name}/{path.stem}")
    for key in ("tolerance", "absolute_tolerance", "max_step", "max_order", "max_steps"):
        if key in content and (isinstance(content[key], bool) or not isinstance(content[key], int | float)):
            raise UserError(f"{key} is {content[key]!r}; allowed: a number")
    for key in ("start_at_equilibrium", "energy_check"):
        if not isinstance(content.get(key, False), bool):
            raise UserError(f"{key} is {content[key]!r}; allowed: true or false")
    scene = scene.changed(**content)
    check_end(model.replaced_inputs, scene.stop_time)
    return scene


def as_toml(scene: Scene) -> str:
    """Return a scene as the text of a file, whatever it was changed by; raises UserError for a mechanism's."""
    if not scene.reference:
        raise UserError(
            f"scene {scene.name!r} has a model without name or file, which a scene file cannot contain; write "
            "the model in a file"
        )
    scene.model.require_parameters("the scene")
    settings = {name: getattr(scene.settings, name) for name in SETTING_NAMES}
    times = {name: getattr(scene, name) for name in ("stop_time", "output_interval")}
    parameters = {p.name: getattr(scene.model, p.name) for p in scene.model.parameters()}
    head = assignments({"model": scene.reference} | settings | times)
    inputs = [f"{json.dumps(name)} = {entry_text(name, value)}" for name, value in scene.model.replaced_inputs.items()]
    given = ["", "[inputs]", *inputs] if inputs else []
    return "\n".join([*head, "", "[parameters]", *assignments(parameters), *given]) + "\n"


def assignments(values: dict[str, Any]) -> list[str]:
    """Return a line of TOML for each value; texts, numbers and truth values are written as in JSON."""
    return [f"{name} = {json.dumps(value, ensure_ascii=False)}" for name, value in values.items()]
