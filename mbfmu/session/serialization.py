"""States as bytes that can be trusted: framed with whose they are, their length, and a checksum of all of it.

A state is a head, which JSON holds, and a body of bytes.
"""

from __future__ import annotations

import json
from hashlib import blake2b
from typing import Any
from zlib import crc32

from mbfmu.util.errors import UserError

MAGIC = b"mbfmu3rd"
CHECKSUM, OWNER, LENGTH = 4, 16, 8  # bytes
DESCRIBED = len(MAGIC) + CHECKSUM  # where what is checked begins
FRONT = DESCRIBED + OWNER + LENGTH  # what stands before the content


def frame(owner: str, head: dict[str, Any], body: bytes) -> bytes:
    """Return a state as bytes; ``owner`` identifies what can restore it."""
    text = json.dumps(head).encode()
    content = len(text).to_bytes(LENGTH, "little") + text + body
    described = _digest(owner) + len(content).to_bytes(LENGTH, "little")
    return b"".join((MAGIC, crc32(content, crc32(described)).to_bytes(CHECKSUM, "little"), described, content))


def unframe(owner: str, framed: bytes) -> tuple[dict[str, Any], bytes]:
    """Return head and body of :func:`frame`; raises UserError where the state is damaged or another owner's."""
    if not isinstance(framed, bytes):
        raise UserError(f"a saved state is {framed!r}; allowed: bytes that save() returned", "saved-state")
    if len(framed) < FRONT or framed[: len(MAGIC)] != MAGIC:
        raise UserError(
            f"a saved state of {len(framed)} bytes is not one of this version of mbfmu; save it again", "saved-state"
        )
    length = int.from_bytes(framed[DESCRIBED + OWNER : FRONT], "little")
    if length != len(framed) - FRONT:
        raise UserError(
            f"a saved state is damaged: it has {len(framed) - FRONT} bytes instead of {length}; save it again",
            "saved-state",
        )
    if crc32(memoryview(framed)[DESCRIBED:]) != int.from_bytes(framed[len(MAGIC) : DESCRIBED], "little"):
        raise UserError("a saved state is damaged: its checksum differs; save it again", "saved-state")
    if framed[DESCRIBED : DESCRIBED + OWNER] != _digest(owner):
        raise UserError(
            "a saved state belongs to another model, to other values of fixed parameters, or to another solver; "
            "restore "
            "a state of the same model, parameters and solver",
            "saved-state",
        )
    split = FRONT + LENGTH + int.from_bytes(framed[FRONT : FRONT + LENGTH], "little")
    return json.loads(framed[FRONT + LENGTH : split]), framed[split:]


def _digest(owner: str) -> bytes:
    return blake2b(owner.encode(), digest_size=OWNER).digest()
