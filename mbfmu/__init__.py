"""Multibody mechanisms in relative coordinates, packaged as FMUs.

A first session::

    import mbfmu as mb

    m = mb.Mechanism(gravity=(0, -9.81, 0))
    arm = m.body("arm", m.ground, mb.Revolute(start=0.3), **mb.rod(mass=1.0, length=1.0))
    m.output("arm.angle", arm.angle(), "angle")
    result = mb.simulate(m, 5.0)
    result["arm.angle"], result.plot()

What is named in ``__init__.pyi`` is loaded when it is first used.
"""

from typing import Any

import lazy_loader

from .util.errors import RENAMED, missing_attribute

__version__ = "0.2.0"

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name in RENAMED:
        raise missing_attribute("mbfmu", name)
    return _load(name)
