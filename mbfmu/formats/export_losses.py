"""Parts of a mechanism without a counterpart in MJCF or URDF."""

from __future__ import annotations

from typing import Literal

from mbfmu.util.diagnostics import Diagnostic

from .losses import listed, printable

ExportKey = Literal[
    "rates", "drives", "cut joints", "couplings", "inputs of gravity", "signals of gravity", "forces", "signals",
    "limits", "shapes", "blocks", "events", "starts", "loops", "springs", "inputs", "friction", "gravity", "armatures",
    "meshes", "mesh formats", "input starts", "mimics", "inertias",
]  # fmt: skip
ADD = "Add them in the program that reads the file if they matter"
EXPORT_LOSSES: dict[ExportKey, tuple[str, str]] = {  # what is not exported, and what this means
    "rates": ("velocities of joints at the start", "Joints start at rest"),
    "drives": ("motions of driven joints", "These joints move freely. Control them in the program that reads the file"),
    "cut joints": ("loop-closing joints of these types", "The loops are open"),
    "couplings": ("couplings other than gears", "These joints move independently"),
    "inputs of gravity": ("inputs of gravity", "Gravity has its start value"),
    "signals of gravity": ("gravity that depends on time", "These components are zero"),
    "forces": ("forces", ADD),
    "signals": ("forces that depend on time, sensors or blocks", ADD),
    "limits": ("stops at one end of a coordinate, and a second stop of a coordinate", "These joints move beyond"),
    "input starts": ("start values of inputs", "Controls start at zero. Set them in the program that reads the file"),
    "inertias": (
        "moments of inertia below 2e-15 kg m^2, or masses below 2e-15 kg, which MuJoCo does not allow",
        "These bodies have the smallest allowed values, and move otherwise. Give them a larger mass and inertia",
    ),
    "meshes": ("mesh files that cannot be read", "They are not drawn. Correct the paths of these shapes"),
    "mesh formats": (
        "mesh files that MuJoCo cannot read",
        "They are not drawn. MuJoCo reads OBJ and binary STL files of 4 or more points and up to 200,000 triangles",
    ),
    "mimics": (
        "gears of joints that are locked or follow two joints, since a joint of URDF follows one that moves",
        "These joints move independently",
    ),
    "friction": ("Stribeck friction and static friction above sliding friction", "Friction is that of sliding"),
    "shapes": ("shapes of these bodies", "They are not drawn"),
    "blocks": ("blocks, states and controllers", ADD),
    "events": ("events", ADD),
    "starts": ("start positions", "All coordinates start at zero"),
    "loops": (
        "loop-closing joints, since URDF describes trees only",
        "The loops are open. Close them by the option --close of `mbfmu import`",
    ),
    "armatures": ("armatures of joints", "URDF has none. Add them in the program that reads the file"),
    "springs": ("springs of joints and between points", ADD),
    "inputs": ("inputs with a gain or an offset", "URDF has one drive for each joint"),
    "gravity": ("gravity", "URDF has none; set it in the program that reads the file"),
}


class ExportLosses:
    """Collected losses and changes of an export."""

    def __init__(self) -> None:
        self._names: dict[ExportKey, list[str]] = {}
        self._notes: list[Diagnostic] = []

    def add(self, key: ExportKey, name: str = "") -> None:
        """Add an element that is not exported."""
        self._names.setdefault(key, []).append(printable(name))

    def note(self, text: str, remedy: str = "") -> None:
        """Add a part that is exported in another form."""
        self._notes.append(Diagnostic.note("changed-export", text, remedy))

    def diagnostics(self) -> list[Diagnostic]:
        """Return a warning for each kind of loss, and the notes."""
        found = []
        for key, names in self._names.items():
            what, meaning = EXPORT_LOSSES[key]
            which = listed([name for name in dict.fromkeys(names) if name])
            text = f"not exported: {what}" + (f" ({which})" if which else "")
            found.append(Diagnostic.warning("not-exported", text, meaning))
        return [*found, *self._notes]
