"""What a process of the pool loads first: Ctrl-C in a terminal reaches it too, and is for the study to answer."""

import signal
from typing import Any


def dask_setup(_: Any) -> None:
    """Be deaf to it; Dask calls this by its name."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
