"""What travels in an FMU for people: a page that lists its variables, and the licenses of what is in it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape
from importlib.metadata import distribution
from pathlib import Path
from textwrap import dedent

import fmpy

import mbfmu
import mbfmu.native
from mbfmu.modeling.model import Model
from mbfmu.modeling.variables import Role, ScalarVariable, columns
from mbfmu.native.sundials_files import license_text
from mbfmu.util.errors import UserError

C_FOLDER = Path(mbfmu.native.__file__).parent / "c"
PAGE_STYLE = (
    "body{font:15px/1.5 sans-serif;margin:2em auto;max-width:70em;padding:0 1em}"
    "table{border-collapse:collapse}td,th{padding:.2em .8em;border-bottom:1px solid #ccc;text-align:left}"
    "td:first-child{font-family:monospace;white-space:nowrap}"
)


def page(model: Model, variables: Sequence[ScalarVariable], *, needs_python: bool) -> str:
    """Return a page that describes the model and lists every variable."""
    needs = ", which must be installed in the host's Python" if needs_python else "; it needs nothing else to run"
    tables = "".join(_table(role, [v for v in variables if v.role is role]) for role in Role)
    return (
        f"<!DOCTYPE html><html lang='en'><head><meta charset='utf-8'><title>{escape(model.name)}</title>"
        f"<style>{PAGE_STYLE}</style></head><body><h1>{escape(model.name)}</h1><p>{escape(model.title())}</p>{tables}"
        f"<p>Made by mbfmu {mbfmu.__version__}{needs}.</p></body></html>"
    )


def _table(role: Role, variables: Sequence[ScalarVariable]) -> str:
    if not variables:
        return ""
    told = columns(variables)
    head = "".join(f"<th>{title}</th>" for title in told)
    rows = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
        for row in zip(*told.values(), strict=True)
    )
    return f"<h2>{role.plural}</h2><table><tr>{head}</tr>{rows}</table>"


def licenses(*, native: bool, sundials: bool = False) -> dict[str, bytes]:
    """Return the texts of the licenses of what an FMU contains, by the name of a file; ``license.txt`` lists them.

    ``sundials``: it contains the libraries of SUNDIALS.
    """
    texts = {"mbfmu": _license("mbfmu")}
    texts |= {"fmi-headers": _header_license()} | ({} if native else {"pythonfmu": _license("pythonfmu")})
    texts |= {"sundials": license_text()} if sundials else {}
    texts["license"] = "".join(
        ["This FMU contains software under the licenses in these files:\n", *(f"- {name}.txt\n" for name in texts)]
    )
    return {f"{name}.txt": text.encode() for name, text in texts.items()}


def c_sources() -> dict[str, bytes]:
    """Return the C sources of a native FMU, which implement FMI over the kernels, by their names in the FMU."""
    return {f"documentation/source/{path.name}": path.read_bytes() for path in sorted(C_FOLDER.glob("*.[ch]"))}


def dependencies() -> dict[str, bytes]:
    """Return the file that states what an FMU that calls Python requires, by its name in the FMU."""
    text = (
        "This FMU calls Python. The importing tool must run in, or find, a Python in which version "
        f"{mbfmu.__version__} of the package mbfmu is installed:\n\n    pip install mbfmu=={mbfmu.__version__}\n\n"
        "If the importing tool is not a Python program, the environment variable MBFMU_PYTHON is the program of this "
        "Python, such as /home/me/venv/bin/python3. Without it the first python3 in the folders of PATH is used.\n"
    )
    return {"documentation/externalDependencies.txt": text.encode()}


def _header_license() -> str:
    """Return the license in the headers of FMI, which the C code of an FMU is compiled with."""
    path = Path(fmpy.__file__).parent / "c-code" / "fmi2Functions.h"
    found = re.search(r"Copyright.*?(?=\*/)", path.read_text("utf-8"), re.DOTALL)
    if found is None:
        raise UserError(f"{str(path)!r} contains no license; install fmpy again")
    return f"Headers of the Functional Mock-up Interface\n\n{dedent('   ' + found.group())}"


def _license(package: str) -> str:
    for file in distribution(package).files or ():
        if file.name.startswith("LICENSE") and ".dist-info" in str(file):
            return file.read_text("utf-8")
    raise UserError(f"package {package!r} is installed without its license; install it again")
