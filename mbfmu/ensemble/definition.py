"""A study as it is written: what runs, what varies, what is measured, and what is aimed at.

scene = "fourbar/paper"        # as `mbfmu run` takes it; or fmu = "thing.fmu", of any tool
with = "simulation"            # or fmu, native: through an FMU of the scene
count = 1000                   # samples of what has a distribution
sampling = "random"            # latin, sobol, sensitivity, tornado
seed = 1
together = false               # lists go together, in place of all combinations
correlated = [["crank_length", "rocker_length", 0.8]]
keep = ["crank.angle"]         # outputs whose whole history is kept
stop_time = 10.0               # s; the scene's where it is not given, as output_interval
time_limit = 60.0              # s by the clock for each run, which fails after it; without it there is none

[inputs]                       # of the model: a number, an expression of t (s), a file, or points; as in a scene file
force = "10 * sin(30 * t)"

[fixed]                        # what differs from the scene in every run
solver = "adams"

[vary]
crank_length = "1 m +- 0.01 mm"
gravity = [1.62, 3.71, 9.81]
coupler_mass = {distribution = "norm", loc = 1.0, scale = 0.1}

[measure]
reach = "largest coupler.tip.x"
turned = {take = "crossing", output = "crank.angle", threshold = 3.14}

[aim]                          # instead of sampling: minimize, maximize, or targets of measures
minimize = "reach"
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from mbfmu.modeling.modules import load_module
from mbfmu.modeling.replaced_inputs import in_folder
from mbfmu.util.errors import UserError, short, suggest
from mbfmu.util.toml import read_toml

from .design import Point, Sampling, correlations, points
from .measures import Measure, Own, Steady, read_measure
from .objective import Objective, read_objective
from .study_target import ModelTarget, StudyTarget, check_point, content_digest, files_of, make_target, unknown_name
from .variation import Drawn, Listed, Variation, read_variation
from .worker import Files, FmuJob, ModelJob, dump

SAMPLING_KEYS = ("count", "sampling", "seed", "together", "correlated")
STUDY_KEYS = (
    "scene",
    "fmu",
    "with",
    "stop_time",
    "output_interval",
    "time_limit",
    *SAMPLING_KEYS,
    "keep",
    "inputs",
    "fixed",
    "vary",
    "measure",
    "aim",
)
MAX_TIME_LIMIT = 1e6  # s
TRIED_PROBABILITIES = np.array([0.313, 0.5017, 0.7729])  # probabilities at which a distribution is tried
MEASURE_NAME_PATTERN = re.compile(r"\w[\w .+-]{0,59}")  # of a measure, and so of files
RUN_COLUMNS = ("run", "key", "status", "message", "energy_error", "seconds")  # of a table of runs, before the study's
HISTORY_COLUMNS = ("run", "key", "time")  # of a table of histories, without outputs


@dataclass(frozen=True, kw_only=True)
class Definition:
    """A study that has been checked.

    Attributes
    ----------
    fixed, vary
        Values that every run has, and what varies, by name.
    measures
        What is measured of each run, in order.
    keep
        Outputs whose history is kept.
    content
        What was written, for people and for the results.
    time_limit
        Longest time of a run by the clock, s; 0: there is none.
    """

    target: StudyTarget
    fixed: dict[str, Any]
    vary: dict[str, Variation]
    sampling: Sampling
    measures: tuple[Measure, ...]
    measure_files: tuple[Files, ...]
    keep: tuple[str, ...]
    aim: Objective | None
    content: dict[str, Any]
    time_limit: float = 0.0

    def job(self) -> ModelJob | FmuJob:
        """Return what all its runs share."""
        found = self.target.job(
            measures=dump(self.measures), measure_files=self.measure_files, keep=self.keep, fixed=self.fixed
        )
        return replace(found, time_limit=self.time_limit)

    def identity(self) -> str:
        """Return the identity of the runs of a study, independent of what is varied."""
        told = [(m.name, getattr(m, "source", None) or repr(m)) for m in self.measures]
        bare = self.target.job(measures=b"", measure_files=(), keep=self.keep, fixed=self.fixed)
        return content_digest(bare.identity, bare.version, told)

    def points(self) -> list[Point]:
        """Return the points of its runs, in order."""
        return points(self.vary, self.sampling)

    def units(self) -> dict[str, str]:
        """Return the units of what varies and of what is measured."""
        varied = {name: self.target.units[name] for name in self.vary}
        return varied | {m.name: m.unit(self.target.outputs) for m in self.measures}


def key_of(identity: str, point: Point) -> str:
    """Return the key of a run: of the study's identity and of the point."""
    return sha256(f"{identity}{json.dumps(point, sort_keys=True)}".encode()).hexdigest()[:20]


def read_study(path: Path) -> dict[str, Any]:
    """Return the content of a study file, with paths relative to the working directory.

    Raises
    ------
    UserError
        The file cannot be read, or it is no TOML.
    """
    content = read_toml(path, "study file")
    for key in ("scene", "fmu"):
        value = content.get(key)
        if isinstance(value, str) and (key == "fmu" or value.endswith(".toml") or ".py" in value):
            content[key] = str(path.parent / value)
    measures = content.get("measure")
    if isinstance(measures, dict):
        content["measure"] = {
            name: str(path.parent / value) if isinstance(value, str) and ".py:" in value else value
            for name, value in measures.items()
        }
    inputs = content.get("inputs")
    if isinstance(inputs, dict):
        content["inputs"] = {name: in_folder(value, path.parent) for name, value in inputs.items()}
    return content


def define(content: Mapping[str, Any]) -> Definition:
    """Return a study, checked against what it is of.

    Parameters
    ----------
    content
        By the keys of a study file; ``scene`` may be a scene, a model or a mechanism, a variation a frozen distribution
        of ``scipy.stats``, and a measure a function.

    Raises
    ------
    UserError
        A key, a name, a range, a measure or a distribution is wrong: which, its value, and what is allowed.
    """
    for key in content:
        if key not in STUDY_KEYS:
            raise UserError(f"a study has no key {key!r}{suggest(str(key), STUDY_KEYS)}")
    given = content.get("fmu") or content.get("scene")
    if given is None or ("fmu" in content and "scene" in content):
        raise UserError("a study contains both scene and fmu, or neither; give one of them")
    if "fmu" in content and not str(given).endswith(".fmu"):
        raise UserError(f"fmu is {given!r}; allowed: the path of a file whose name ends in .fmu")
    if "fmu" in content and content.get("with", "fmu") != "fmu":
        raise UserError(f"with = {content['with']!r} and an fmu are given; leave out one of the two")
    runs, times = content.get("with", "simulation"), (content.get("stop_time"), content.get("output_interval"))
    subject = make_target(given, runs, *times, content.get("inputs", {}))
    vary = _vary(subject, content.get("vary"))
    fixed = _fixed(subject, content.get("fixed", {}), vary)
    aim = read_objective(content.get("aim"), vary, content.get("measure") or {})
    for key in ("sampling", "correlated"):
        if aim and key in content:
            raise UserError(
                f"{key} and an aim are given, but an optimization does not sample; leave out one of the two"
            )
    measures, files = _measures(subject, content.get("measure") or {}, vary)
    _refuse_inputs(subject, measures, (*vary, *fixed))
    given_sampling = {("method" if k == "sampling" else k): content[k] for k in SAMPLING_KEYS if k in content}
    if "correlated" in given_sampling:
        given_sampling["correlated"] = correlations(given_sampling["correlated"], vary)
    return Definition(
        target=subject,
        fixed=fixed,
        vary=vary,
        sampling=Sampling(**given_sampling),
        measures=measures,
        measure_files=files,
        keep=_kept(subject, content.get("keep", ())),
        aim=aim,
        time_limit=_time_limit(content.get("time_limit")),
        content={k: v if k not in ("scene", "inputs", "vary", "measure") else _as_json(v) for k, v in content.items()},
    )


def _time_limit(given: Any) -> float:
    """Return the time limit of a run in s; 0 if none is given."""
    if given is None:
        return 0.0
    if isinstance(given, bool) or not isinstance(given, int | float) or not 0.0 < given <= MAX_TIME_LIMIT:
        raise UserError(
            f"time_limit is {short(given)}; allowed: a number of seconds above 0, at most {MAX_TIME_LIMIT:g}"
        )
    return float(given)


def _as_json(value: Any) -> Any:
    """Return a part of a study as JSON can say it."""
    if isinstance(value, Mapping):
        return {name: _as_json(own) for name, own in value.items()}
    if isinstance(value, list | tuple):
        return [_as_json(own) for own in value]
    return value if isinstance(value, str | int | float | bool) else repr(value)


def _vary(target: StudyTarget, given: Any) -> dict[str, Variation]:
    if not isinstance(given, Mapping) or not given:
        raise UserError(f"vary is {given!r}; allowed: a table with at least one parameter or input")
    found: dict[str, Variation] = {}
    for name, value in given.items():
        if name not in target.units:
            raise unknown_name(target, str(name))
        if name in RUN_COLUMNS:
            raise UserError(
                f"{name!r} cannot vary, because every table of results has a column of this name; allowed: one "
                "value, in fixed"
            )
        own = read_variation(name, value, target.units[name])
        if isinstance(own, Listed):
            own = Listed(tuple(check_point(target, {name: x})[name] for x in own.values))
        else:
            _check_samples(target, name, own)
        found[name] = own
    return found


def _check_samples(target: StudyTarget, name: str, own: Drawn) -> None:
    """Refuse what draws nothing that may be; some of what it draws may be beyond the limits of a parameter."""
    errors = []
    for value in (some := own.values(TRIED_PROBABILITIES)):
        try:
            check_point(target, {name: value})
        except UserError as error:
            errors.append(error)
    if len(errors) == len(some):
        raise errors[0]


def _refuse_inputs(target: StudyTarget, measures: Sequence[Measure], names: Sequence[str]) -> None:
    """Refuse inputs together with measures of the steady state, which uses their start values."""
    steady = next((measure.name for measure in measures if isinstance(measure, Steady)), None)
    given = next((name for name in names if isinstance(target, ModelTarget) and name in target.inputs), None)
    if steady is not None and given is not None:
        raise UserError(
            f"measure {steady!r} is evaluated at the steady state, at which the input {given!r} has its start "
            "value; vary a parameter that determines the start value, or measure runs"
        )


def _fixed(target: StudyTarget, given: Any, vary: Mapping[str, Variation]) -> dict[str, Any]:
    if not isinstance(given, Mapping):
        raise UserError(f"fixed is {given!r}; allowed: a table of values by their names")
    for name in given:
        if name not in target.units:
            raise unknown_name(target, str(name))
        if name in vary:
            raise UserError(f"{name!r} is fixed and varies; allowed: one of the two")
    return check_point(target, dict(given))


def _measures(
    target: StudyTarget, given: Any, vary: Mapping[str, Variation]
) -> tuple[tuple[Measure, ...], tuple[Files, ...]]:
    if not isinstance(given, Mapping):
        raise UserError(f"measure is {given!r}; allowed: a table of measures by their names")
    found: list[Measure] = []
    files: dict[str, Files] = {}
    for name, value in given.items():
        if name in vary or name in RUN_COLUMNS:
            what = "varies" if name in vary else "every table of results has"
            raise UserError(f"measure {name!r} has a name that {what}; give it another name")
        if not MEASURE_NAME_PATTERN.fullmatch(str(name)):
            raise UserError(
                f"measure {name!r} has a name that is not a valid file name; allowed: at most 60 letters, "
                "digits, . + - _"
            )
        if callable(value):
            found.append(Own(name, value, content_digest(dump(value))))
        elif isinstance(value, str) and ".py:" in value:
            path, _, function = value.rpartition(":")
            files[path] = files.get(path) or _loaded(name, Path(path))
            own = getattr(load_module(Path(path)), function, None)
            if not callable(own):
                raise UserError(
                    f"measure {name!r}: {path!r} has no function {function!r}; name one that the file defines"
                )
            found.append(Own(name, own, content_digest(value.rpartition("/")[2], files[path].contents)))
        else:
            found.append(read_measure(name, value, tuple(target.outputs), target.steady))
    return tuple(found), tuple(files.values())


def _loaded(name: str, path: Path) -> Files:
    try:
        load_module(path)
    except OSError as error:
        raise UserError(f"measure {name!r}: {str(path)!r} cannot be read: {error.strerror}") from error
    return files_of(path)


def _kept(target: StudyTarget, given: Any) -> tuple[str, ...]:
    if not isinstance(given, list | tuple) or not all(isinstance(name, str) for name in given):
        raise UserError(f"keep is {given!r}; allowed: a list of outputs, or ['*'] for all")
    names = tuple(target.outputs) if tuple(given) == ("*",) else tuple(given)
    for name in names:
        if name not in target.outputs:
            raise UserError(f"keep: there is no output {name!r}{suggest(name, target.outputs)}")
        if name in HISTORY_COLUMNS:
            raise UserError(
                f"keep: output {name!r} cannot be kept, because every table of histories has a column of this name"
            )
    return names
