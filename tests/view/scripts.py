"""The page's own program without a page: its modules in node, one after the other as a page has them."""

from __future__ import annotations

import json
import shutil
import subprocess
from importlib.resources import files
from typing import Any

from mbfmu.viewer import html

NODE = shutil.which("node")


def evaluated(code: str, page: str = "") -> Any:
    """What the body ``code`` of an async function returns, with the modules, uPlot, and the blocks of a page."""
    folder = files("mbfmu.viewer")
    modules = [folder / "page" / f"{name}.js" for name in html.SCRIPTS if name not in ("input_controls", "viewer")]
    plot = folder / "vendor" / "uPlot.iife.min.js"
    parts = [
        f"const page = {json.dumps(page)};",
        'const block = (id) => page.match(new RegExp(`id="${id}">([^<]*)<`))[1];',
        "const document = { getElementById: (id) => ({ textContent: block(id) }) };",
        "const window = new EventTarget(), matchMedia = () => new EventTarget();",
        "const devicePixelRatio = 1, addEventListener = () => {}, navigator = { language: 'en-US' };",
        plot.read_text(),
        *(module.read_text() for module in modules),
        f"(async () => {{ {code} }})().then((found) => console.log(JSON.stringify(found)));",
    ]
    program = "\n".join(parts)
    done = subprocess.run([str(NODE), "-"], input=program, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)
