"""Parts of an imported file without a counterpart, and parts that are imported in another form."""

from __future__ import annotations

from typing import Literal

from mbfmu.util.diagnostics import Diagnostic

MAX_NAMES = 5  # that a message lists
MAX_NAME_LENGTH = 80  # characters of a name in a message
OTHER_MOTION = "The motion differs from that of the file. Add them in the Python model if they matter"

Key = Literal[
    "contact", "ball range", "ball spring", "ball damping", "ball armature", "ball friction", "polynomial", "yield",
    "empty range", "reversed range", "planar range", "range margin", "compensation limit", "tendon", "tendon range",
    "unloaded range", "tendon friction",
    "actuator", "transmission", "locked drive", "actuator limits", "reversed limits", "delay", "velocity limits",
    "safety", "tendon equality", "equality", "inactive", "mocap", "fluid", "flex", "plugin", "mimic", "unknown",
]  # fmt: skip
LOSSES: dict[Key, tuple[str, str]] = {  # what is not imported, and what this means
    "contact": ("contact between shapes", "Bodies pass through each other and through the ground"),
    "ball range": ("ranges of ball joints", "These joints rotate without limits"),
    "ball spring": ("springs of ball joints and free joints", OTHER_MOTION),
    "ball damping": ("damping of ball joints and free joints", OTHER_MOTION),
    "ball armature": ("armature of ball joints and free joints", OTHER_MOTION),
    "ball friction": ("dry friction of ball joints and free joints", OTHER_MOTION),
    "polynomial": ("nonlinear terms of the stiffness or damping of joints, tendons and actuators", OTHER_MOTION),
    "yield": ("plastic yielding of springs", OTHER_MOTION),
    "empty range": ("ranges whose ends coincide", "These joints move without limits. Weld them if they shall not move"),
    "reversed range": (
        "ranges whose lower end is above the upper one",
        "These joints move without limits. Exchange lower and upper in the file",
    ),
    "planar range": ("ranges of planar joints", "These joints move without limits"),
    "range margin": ("margins of ranges", "The stops act at the ends of the ranges"),
    "compensation limit": (
        "gravity compensation within the limits of drives (actuatorgravcomp)",
        "The compensation acts in addition to the limited force",
    ),
    "tendon": ("springs of tendons, but those between two sites or of up to three joints", OTHER_MOTION),
    "unloaded range": ("springs of tendons with a range of unloaded lengths", OTHER_MOTION),
    "tendon range": ("ranges of tendons, but those between two sites", OTHER_MOTION),
    "tendon friction": ("friction, armature and damping by actuators of tendons", OTHER_MOTION),
    "actuator": ("actuators with dynamics, muscles and user-defined laws", "They exert no force. Add them as inputs"),
    "transmission": (
        "actuators that do not act on hinges, slides or tendons of up to three of them",
        "They exert no force. Add them as inputs",
    ),
    "locked drive": ("drives of locked joints", "They have no effect"),
    "actuator limits": (
        "limits of the sum of the forces of several actuators, and limits that exclude each other",
        "Limit the inputs in the controller",
    ),
    "reversed limits": (
        "limits of actuators whose lower end is above the upper one",
        "MuJoCo does not use them. Exchange the ends in the file",
    ),
    "delay": ("delays of actuators", "Inputs act at once. Delay the signals that set them"),
    "velocity limits": ("velocity limits of joints", "The joints can be faster"),
    "safety": ("soft limits of <safety_controller>", "Limit the inputs in the controller"),
    "tendon equality": (
        "equality constraints of tendons with more than two joints, or of spatial tendons",
        OTHER_MOTION,
    ),
    "equality": ("equality constraints but connect, weld, joint and tendon", OTHER_MOTION),
    "inactive": ("equality constraints that are inactive at the start", "They are never active"),
    "mocap": ("mocap bodies", "They are fixed where they start"),
    "fluid": ("forces of the fluid (density, viscosity, wind)", OTHER_MOTION),
    "flex": ("flexible bodies (flex)", OTHER_MOTION),
    "plugin": ("plugins", OTHER_MOTION),
    "mimic": ("<mimic> of joints", "These joints move independently"),
    "unknown": (
        "elements and attributes that URDF does not define",
        "Check the spelling, or add them in the Python model",
    ),
}


class Losses:
    """Collected losses and changes."""

    def __init__(self) -> None:
        self._names: dict[Key, list[str]] = {}
        self._notes: list[Diagnostic] = []

    def add(self, key: Key, name: str = "") -> None:
        """Add an element that is not imported; the empty name is one that is only counted."""
        self._names.setdefault(key, []).append(printable(name))

    def note(self, text: str, remedy: str = "") -> None:
        """Add a part that is imported in another form."""
        self._notes.append(Diagnostic.note("changed-import", text, remedy))

    def diagnostics(self) -> list[Diagnostic]:
        """Return a warning for each kind of loss, and the notes."""
        found = []
        for key, names in self._names.items():
            what, meaning = LOSSES[key]
            named = [name for name in dict.fromkeys(names) if name]
            which = listed(named) if named else f"{len(names)} shapes" if key == "contact" else ""
            text = f"not imported: {what}" + (f" ({which})" if which else "")
            found.append(Diagnostic.warning("not-imported", text, meaning))
        return [*found, *self._notes]


def printable(text: str) -> str:
    """Return text from a file without control characters, and not longer than a message can show."""
    shown = "".join(letter if letter.isprintable() else "?" for letter in text)
    return shown if len(shown) <= MAX_NAME_LENGTH else f"{shown[:MAX_NAME_LENGTH]}..."


def listed(names: list[str]) -> str:
    """Return names as text, the first of them if there are many."""
    return ", ".join(names[:MAX_NAMES]) + (f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else "")
