"""Python code of a model from the description of its mechanism: what users keep, edit and export."""

from __future__ import annotations

from textwrap import wrap

import mbfmu

from .description import Description
from .names import RESERVED, Names
from .statements import Statements, text_of

USE_TEXT = "Edit this file as required: neither the imported file nor MuJoCo is needed any more. Units are SI and rad."
LISTS = {"warning": "Not imported", "note": "Changed"}  # titles, by the severity of the diagnostics


def source_of(description: Description) -> str:
    """Return the Python code of a model.

    Parameters
    ----------
    description
        Description of the mechanism.
    """
    statements = Statements(description)
    words = "".join(part[:1].upper() + part[1:] for part in description.name.split("_"))
    title = Names(RESERVED).new(words, "Imported")
    needs_rotations = any("Rotation." in line for line in statements.lines)
    folder = [f"FOLDER = Path({text_of(str(description.folder))})  # of the meshes in pictures", ""]
    lines = [
        *docstring(description),
        "",
        "from dataclasses import dataclass",
        *(["from pathlib import Path"] if statements.uses_folder else []),
        "",
        *(["from scipy.spatial.transform import Rotation", ""] if needs_rotations else []),
        "import mbfmu as mb",
        "",
        *(folder if statements.uses_folder else []),
        "",
        "@dataclass(frozen=True, kw_only=True)",
        f"class {title}(mb.Model):",
        f'    """Mechanism of {quotable(description.source)}."""',
        "",
        f'    name = "{description.name}"',
        "",
        *statements.parameters,
        "",
        "    def build(self):",
        '        """Return the mechanism."""',
        f"        m = mb.Mechanism(gravity={statements.gravity})",
        *statements.lines,
        "        return m",
    ]
    return "\n".join(lines) + "\n"


def docstring(description: Description) -> list[str]:
    """Return the docstring of the module: the origin, what is not imported, and names that are changed."""
    lines = [
        f"Model of {description.source}, imported by mbfmu {mbfmu.__version__} ({description.origin}).",
        "",
        USE_TEXT,
    ]
    for severity, title in LISTS.items():
        texts = [d.message.removeprefix("not imported: ") for d in description.diagnostics if d.severity == severity]
        if texts:
            lines += ["", f"{title}:", *(line for text in texts for line in item(text))]
    if description.renamed:
        lines += ["", "Names:", *(line for old, new in description.renamed.items() for line in item(f"{old}: {new}"))]
    first, *others = map(quotable, lines)
    return [f'"""{first}', *others, '"""']


def quotable(text: str) -> str:
    """Return text as part of a docstring."""
    return text.replace("\\", "\\\\").replace('"', "'")


def item(text: str) -> list[str]:
    """Return the lines of an item of a list."""
    return wrap(text, 110, initial_indent="- ", subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
