"""How Sphinx builds the site: ``python -m sphinx -W --keep-going docs build/site``.

Nothing is fetched: formulas become MathML, and no other project's index of names is asked for.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

import mbfmu

project = "mbfmu"
author = "the mbfmu maintainers"
copyright = author
version = release = mbfmu.__version__

extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "myst_nb", "sphinx_copybutton"]
extensions += ["mathml", "fields", "names", "animations", "links", "model_pages"]  # ours, in _ext
exclude_patterns = ["_ext", "**/.ipynb_checkpoints"]

html_theme = "furo"
html_title = "mbfmu"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False

myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "attrs_inline"]
myst_heading_anchors = 3

nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 900  # s a cell: the first one compiles where nothing is in the cache

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
autodoc_class_signature = "mixed"
napoleon_google_docstring = False
napoleon_use_rtype = False

copybutton_exclude = ".linenos, .gp, .go"

nitpicky = True
nitpick_ignore = [
    ("py:class", "Vector"),  # aliases that annotations spell out
    ("py:class", "Array"),
    ("py:class", "Arrays"),  # what kernels are called with
    ("py:class", "State"),
    ("py:class", "dict[float"),
    ("py:func", "scale.characteristic_length"),  # no part of the site
    ("py:attr", "System.dynamics"),
    ("py:class", "UserSolverError"),  # described in the text of Status
]


def setup(app: Any) -> dict[str, bool]:
    """Tell Sphinx that pages may be read side by side."""
    return {"parallel_read_safe": True}
