"""What a study runs: a scene of a model, directly or as an FMU, or any FMU for co-simulation."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

import mbfmu
from mbfmu.mechanics import Mechanism
from mbfmu.modeling.model import Model, as_model
from mbfmu.modeling.parameters import check, declared
from mbfmu.modeling.replaced_inputs import check_run, describe, read_entry
from mbfmu.modeling.scene import Scene, check_times, default_scene, load_scene
from mbfmu.modeling.settings import Settings
from mbfmu.modeling.variables import ENERGY_OUTPUTS
from mbfmu.session.run import check_interval
from mbfmu.util.errors import UserError, suggest

from .design import Point
from .worker import STOP_TIME_KEY, Files, FmuJob, Job, ModelJob, dump

RUN_METHODS = ("simulation", "fmu", "native")
NUMBER_TYPES: dict[str, type] = {
    "Real": float, "Integer": int, "Boolean": bool, "Float64": float, "Float32": float,
    **{f"{sign}Int{bits}": int for sign in ("", "U") for bits in (8, 16, 32, 64)},
}  # fmt: skip


def files_of(path: Path) -> Files:
    """Return a loaded user's file with those that it imported from its folder; not the script that is run."""
    folder, known = path.resolve().parent, [m for name, m in list(sys.modules.items()) if name != "__main__"]
    own = next((m for m in known if getattr(m, "__mbfmu_file__", "") == str(path.resolve())), None)
    loaded = {Path(file).resolve() for m in known if (file := getattr(m, "__file__", None))}
    beside = {folder / f"{name}.py" for name in getattr(own, "__mbfmu_beside__", ())}
    more = {file for file in loaded if file.parent == folder and file.suffix == ".py"} | beside
    found = [path.resolve(), *sorted(file for file in more if file != path.resolve() and file.exists())]
    return Files(path.name, tuple((file.name, file.read_bytes()) for file in found))


def content_digest(*content: Any) -> str:
    """Return what tells contents apart: hexadecimal digits."""
    told = json.dumps(content, sort_keys=True, default=lambda x: x.hex() if isinstance(x, bytes) else repr(x))
    return sha256(told.encode()).hexdigest()[:24]


def number(what: str, value: Any, kind: type) -> Any:
    """Return a value as the requested type (float, int, bool); raises UserError if that is not possible."""
    if kind is bool:
        if isinstance(value, bool | np.bool_):
            return bool(value)
        raise UserError(f"{what} is {value!r}; allowed: true or false")
    real = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not real or not abs(value) <= sys.float_info.max or (kind is int and value != int(value)):
        raise UserError(f"{what} is {value!r}; allowed: {'a whole' if kind is int else 'a finite'} number")
    return kind(value)


@dataclass(frozen=True)
class ModelTarget:
    """A scene of a model, run without an FMU.

    Attributes
    ----------
    units
        By name of what may vary: parameters of the model, its inputs, settings, and ``stop_time``.
    inputs
        Those of the model.
    outputs
        By name, their units.
    """

    scene: Scene
    units: dict[str, str] = field(init=False)
    inputs: frozenset[str] = field(init=False)
    outputs: dict[str, str] = field(init=False)
    steady = True

    def __post_init__(self) -> None:
        """Build the model once; raises UserError where it cannot be built."""
        compiled, model = self.scene.model.compile(), self.scene.model
        units = {p.name: p.unit for p in declared(Settings)} | {STOP_TIME_KEY: "s"}
        units |= {v.name: v.unit for v in compiled.inputs.variables} | {p.name: p.unit for p in model.parameters()}
        object.__setattr__(self, "units", units)
        object.__setattr__(self, "inputs", frozenset(v.name for v in compiled.inputs.variables))
        checked = ENERGY_OUTPUTS if self.scene.settings.energy_check else ()
        object.__setattr__(self, "outputs", {v.name: v.unit for v in (*compiled.outputs, *checked)})

    @property
    def name(self) -> str:
        """What it is called."""
        return self.scene.name

    @property
    def replaced_inputs(self) -> tuple[str, ...]:
        """A line for every input that a signal replaces."""
        return tuple(describe(self.scene.model.replaced_inputs))

    def check(self, name: str, value: Any) -> Any:
        """Return a value as what varies takes it; raises UserError where it does not."""
        model = self.scene.model
        parameter = next((p for p in model.parameters() if p.name == name), None)
        if parameter is not None:
            return check(model.name, parameter, value)
        if name == STOP_TIME_KEY:
            check_run(model, value, self.scene.settings.tolerance)
            return self.scene.changed(stop_time=value).stop_time
        if name in asdict(self.scene.settings):
            return getattr(self.scene.changed(**{name: value}).settings, name)
        return number(f"input {name!r}", value, float)

    def job(self, **shared: Any) -> ModelJob:
        """Return what workers are given."""
        scene, model = self.scene, self.scene.model
        values = {p.name: getattr(model, p.name) for p in model.parameters()}
        file = getattr(sys.modules.get(type(model).__module__), "__mbfmu_file__", "")
        source: dict[str, Any] = {}
        if file:
            source = {"files": files_of(Path(file)), "class_name": type(model).__name__}
        elif scene.reference and "." not in scene.reference:
            source = {"reference": scene.reference}
        else:
            source = {"pickled": dump(model)}
        if "pickled" not in source:
            model.require_parameters("the study")
        if model.replaced_inputs and "pickled" not in source:
            source["inputs"] = dump(model.replaced_inputs)
        about: dict[str, Any] = {"values": values, "settings": scene.settings, "stop_time": scene.stop_time}
        about |= source | {"interval": scene.output_interval}
        told = {k: asdict(v) if isinstance(v, Settings) else v for k, v in about.items()}
        return ModelJob(identity=content_digest(model.name, told, shared), version=mbfmu.__version__, **about, **shared)


@dataclass(frozen=True)
class FmuTarget:
    """An FMU for co-simulation.

    Attributes
    ----------
    kinds
        By name of what may vary: float, int or bool.
    units, outputs
        By name of what may vary and of outputs, their units.
    is_native
        Whether mbfmu has exported it without Python.
    replaced_inputs
        A line for every input of the model that a signal replaces in the FMU.
    """

    name: str
    content: bytes
    kinds: dict[str, type]
    units: dict[str, str]
    outputs: dict[str, str]
    values: Mapping[str, Any]
    stop_time: float
    interval: float
    is_native: bool = False
    replaced_inputs: tuple[str, ...] = ()
    steady = False

    def check(self, name: str, value: Any) -> Any:
        """Return a value as what varies takes it; raises UserError where it does not."""
        if name == STOP_TIME_KEY:
            check_times(value, self.interval)
        return number(f"variable {name!r} of {self.name!r}", value, self.kinds[name])

    def job(self, **shared: Any) -> FmuJob:
        """Return what workers are given."""
        about: dict[str, Any] = {"values": dict(self.values), "stop_time": self.stop_time, "interval": self.interval}
        about |= {"outputs": tuple(self.outputs.items())}
        identity = content_digest(sha256(self.content).hexdigest(), about, shared)
        about |= {"version": mbfmu.__version__, "content": self.content, "is_native": self.is_native}
        return FmuJob(identity=identity, **about, **shared)


StudyTarget = ModelTarget | FmuTarget


def make_target(
    given: Any, runs: str, stop_time: float | None, interval: float | None, inputs: Mapping[str, Any] | None = None
) -> StudyTarget:
    """Return what is to be run: a scene or its name, a model, a mechanism, or the path of an FMU.

    ``inputs`` are replaced by signals; their values are those of a scene file.

    Raises
    ------
    UserError
        It is none of these, it cannot be built or read, the interval that is given is longer than the run, or an input
        cannot be replaced.
    """
    if runs not in RUN_METHODS:
        raise UserError(f"with is {runs!r}{suggest(str(runs), RUN_METHODS)}")
    if not isinstance(inputs or {}, Mapping):
        raise UserError(f"inputs is {inputs!r}; allowed: a table [inputs] of values by the names of inputs")
    if isinstance(given, str | Path) and str(given).endswith(".fmu"):
        if inputs:
            raise UserError(
                f"inputs {', '.join(inputs)} and an FMU are given; only inputs of models can be replaced by signals. "
                "Give constant values of inputs of an FMU in the table [fixed]"
            )
        fmu = read_fmu(Path(given), stop_time, interval)
        if interval is not None:
            check_interval(fmu.stop_time, interval)
        return fmu
    if isinstance(given, Model | Mechanism):
        given = default_scene(as_model(given))
    scene = load_scene(str(given)) if isinstance(given, str | Path) else given
    if not isinstance(scene, Scene):
        raise UserError(f"scene is {given!r}; allowed: a scene or its name, a model, a mechanism, or an FMU's path")
    scene = scene.changed(stop_time=stop_time, output_interval=interval)
    if interval is not None:
        check_interval(scene.stop_time, interval)
    if inputs:
        values = {name: read_entry(name, value, Path()) for name, value in inputs.items()}
        scene = scene.changed(model=scene.model.with_inputs(values))
    check_run(scene.model, scene.stop_time, scene.settings.tolerance)
    return ModelTarget(scene) if runs == "simulation" else exported(scene, runs == "native")


def exported(scene: Scene, native: bool) -> FmuTarget:
    """Return the FMU of a scene: machine code, or one that calls Python."""
    from mbfmu.fmi.export import FmuKind, export_scene

    with tempfile.TemporaryDirectory(prefix="mbfmu_") as place:
        path = Path(place) / "model.fmu"
        export_scene(scene, path, FmuKind.NATIVE if native else FmuKind.PYTHON, falls_back=False)
        found = read_fmu(path, scene.stop_time, scene.output_interval)
    signals = tuple(describe(scene.model.replaced_inputs))
    return FmuTarget(**{**vars(found), "name": scene.name, "is_native": native, "replaced_inputs": signals})


def read_fmu(path: Path, stop_time: float | None, interval: float | None) -> FmuTarget:
    """Return an FMU; raises UserError where the file is none for co-simulation."""
    from fmpy import read_model_description

    try:
        content, described = path.read_bytes(), read_model_description(str(path))
    except OSError as error:
        raise UserError(f"FMU {str(path)!r} cannot be read: {error.strerror or error}") from error
    except Exception as error:
        raise UserError(f"{str(path)!r} is not an FMU: {error}") from error
    if described.coSimulation is None:
        raise UserError(f"{str(path)!r} is not an FMU for co-simulation; a study requires one")
    single = [v for v in described.modelVariables if v.type in NUMBER_TYPES and not getattr(v, "dimensions", None)]
    settable = [v for v in single if v.causality in ("parameter", "input") and v.variability != "constant"]
    outputs = {v.name: v.unit or "1" for v in single if v.causality == "output"}
    if not outputs:
        raise UserError(f"FMU {str(path)!r} has no numerical output; a study requires at least one")
    usual = described.defaultExperiment
    stop = float(getattr(usual, "stopTime", None) or 0.0) if stop_time is None else stop_time
    if stop_time is None and not stop > 0.0:
        raise UserError(f"FMU {str(path)!r} has no stop time; give stop_time")
    check_times(stop, stop if interval is None else interval)
    step = float(getattr(usual, "stepSize", None) or stop / 500.0) if interval is None else interval
    units = {v.name: v.unit or "1" for v in settable} | {STOP_TIME_KEY: "s"}
    kinds = {v.name: NUMBER_TYPES[v.type] for v in settable} | {STOP_TIME_KEY: float}
    return FmuTarget(path.stem, content, kinds, units, outputs, {}, stop, step)


def check_point(target: StudyTarget, point: Point) -> Point:
    """Return a point as the subject takes it."""
    return {name: target.check(name, value) for name, value in point.items()}


def unknown_name(target: StudyTarget, name: str) -> UserError:
    """Return the complaint that nothing of this name may vary."""
    if isinstance(target, ModelTarget) and name in target.scene.model.replaced_inputs:
        return UserError(
            f"input {name!r} of {target.name!r} is replaced by a signal, so that it cannot vary; leave out the signal "
            "or the variation"
        )
    return UserError(f"{target.name!r} has no parameter or input {name!r} that can vary{suggest(name, target.units)}")


__all__ = ["FmuTarget", "Job", "ModelTarget", "StudyTarget", "make_target"]
