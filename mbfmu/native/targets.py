"""The machines that a runtime can be built for."""

from __future__ import annotations

import platform
from typing import NamedTuple


class Target(NamedTuple):
    """A machine; its name is that of its folder in an FMU of FMI 3."""

    triple: str  # LLVM's
    processor: str  # the oldest that is served
    zig: str  # zig's
    folder: str  # in an FMU of FMI 2; empty: FMI 2 has no such machine
    suffix: str  # of a shared library


TARGETS = {
    "x86_64-linux": Target("x86_64-unknown-linux-gnu", "x86-64", "x86_64-linux-gnu.2.17", "linux64", ".so"),
    "aarch64-linux": Target("aarch64-unknown-linux-gnu", "generic", "aarch64-linux-gnu.2.17", "", ".so"),
    "x86_64-windows": Target("x86_64-w64-windows-gnu", "x86-64", "x86_64-windows-gnu", "win64", ".dll"),
    "aarch64-darwin": Target("arm64-apple-macosx11.0.0", "apple-m1", "aarch64-macos", "", ".dylib"),
    "x86_64-darwin": Target("x86_64-apple-macosx11.0.0", "x86-64", "x86_64-macos", "darwin64", ".dylib"),
}


def host() -> str:
    """Return the name of this machine; empty: it is none of those."""
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())
    name = f"{machine}-{platform.system().lower()}"
    return name if name in TARGETS else ""
