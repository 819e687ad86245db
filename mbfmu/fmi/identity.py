"""Who an FMU is: equal content gives equal names."""

from __future__ import annotations

import json
import re
import uuid
from dataclasses import asdict
from hashlib import sha256
from typing import NamedTuple

import mbfmu
from mbfmu.modeling.model import Model
from mbfmu.modeling.settings import Settings

from .description import Experiment


class Owner(NamedTuple):
    """Names of an FMU: a digest of what is in it, that of its files, and its GUID."""

    digest: str
    identifier: str
    guid: str


def identify(model: Model, settings: Settings, experiment: Experiment, *more: str) -> Owner:
    """Return the names of an FMU of a model with these start values; ``more`` is what else is in it."""
    cls = type(model)
    values = {p.name: getattr(model, p.name) for p in model.parameters()} | model.other_values()
    told = asdict(settings), asdict(experiment)
    identity = json.dumps([mbfmu.__version__, cls.__module__, cls.__qualname__, values, *told, *more])
    digest = sha256(identity.encode()).hexdigest()
    identifier = f"mbfmu_{re.sub(r'[^A-Za-z0-9]', '_', model.name)}_{digest[:8]}"
    return Owner(digest, identifier, str(uuid.uuid5(uuid.NAMESPACE_URL, digest)))
