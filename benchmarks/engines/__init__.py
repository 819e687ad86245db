"""Other engines for ``benchmarks/peers.py``: one file each, which is imported if the engine is installed."""
