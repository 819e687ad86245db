"""The command ``mbfmu``, and ``python -m mbfmu``."""

from __future__ import annotations

import gc
import os
import sys

COMMAND_COLLECTION_THRESHOLDS = 200_000, 20, 100  # most of what a command creates stays until its end


def main() -> int:
    """Run the command. Ctrl-C is handled at all times, also while modules are loaded.

    Before a process ends, Python collects garbage among all objects twice, which takes half a second after a run.
    Objects that are frozen are excluded.
    """
    prepare_streams()
    gc.set_threshold(*COMMAND_COLLECTION_THRESHOLDS)
    try:
        from mbfmu.cli import main as command
    except KeyboardInterrupt:
        print("mbfmu: interrupted before the start", file=sys.stderr)  # noqa: T201
        return 130
    try:
        return command()
    finally:
        gc.freeze()


def prepare_streams() -> None:
    """Let nothing that is printed fail: names of files that are no text, and output that is closed."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by who called the command
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123
        elif name == "stdout" and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="surrogateescape" if stream.encoding.lower() == "utf-8" else "backslashreplace")


if __name__ == "__main__":
    sys.exit(main())
