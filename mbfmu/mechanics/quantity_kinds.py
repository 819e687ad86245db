"""Kinds of quantities in laws and at the inputs of blocks, see :mod:`.quantities`."""

from __future__ import annotations

MAX_QUANTITIES = 8  # arguments of a law, inputs of a block
TIME, POSITION, VELOCITY, SIGNAL, SENSOR, BLOCK, LENGTH, LENGTH_RATE = range(8)
