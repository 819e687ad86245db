"""What a shell completes: names of models, scenes, parameters and outputs, by argcomplete."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from argcomplete.completers import FilesCompleter

from mbfmu.modeling.registry import models
from mbfmu.modeling.scene import load_scene, scenes
from mbfmu.util.errors import UserError

Words = Sequence[str] | Callable[..., Iterable[str]]


def complete(action: argparse.Action, words: Words) -> None:
    """Have the value of an argument completed: with words, or with what a function of argcomplete's arguments gives."""
    setattr(action, "completer", words if callable(words) else lambda **_: words)  # noqa: B010  # as argcomplete has it


def model_names(**_: Any) -> list[str]:
    """Return every model."""
    return sorted(models())


def scene_names(prefix: str = "", **_: Any) -> list[str]:
    """Return every model and its scenes, and files."""
    shipped = [f"{name}/{scene}" for name, model in sorted(models().items()) for scene in scenes(model)]
    files = FilesCompleter(allowednames=(".toml", ".py"))(prefix)
    return [*model_names(), *shipped, *files]


def motion_names(prefix: str = "", **_: Any) -> list[str]:
    """Return what can be viewed: models, scenes and their files, and pose files."""
    return [*scene_names(prefix), *FilesCompleter(allowednames=(".npz",))(prefix)]


def parameter_names(parsed_args: argparse.Namespace, **_: Any) -> list[str]:
    """Return the parameters of the model that the command line names."""
    try:
        return [f"{p.name}=" for p in load_scene(parsed_args.scene).model.parameters()]
    except UserError:
        return []


def output_names(parsed_args: argparse.Namespace, **_: Any) -> list[str]:
    """Return the outputs of the model that the command line names."""
    try:
        return [variable.name for variable in load_scene(parsed_args.scene).model.compile().outputs]
    except UserError:
        return []
