"""States as bytes that can be trusted: framed with whose they are, their length, and a checksum of all of it."""

from __future__ import annotations

from hashlib import blake2b
from zlib import crc32

from mbfmu.errors import UserError

MAGIC = b"mbfmu2nd"
CHECKSUM, OWNER, LENGTH = 4, 16, 8  # bytes
DESCRIBED = len(MAGIC) + CHECKSUM  # where what is checked begins
HEAD = DESCRIBED + OWNER + LENGTH


def frame(owner: str, content: bytes) -> bytes:
    """Return the content with its head; ``owner`` says what can take it up."""
    described = _digest(owner) + len(content).to_bytes(LENGTH, "little")
    return b"".join((MAGIC, crc32(content, crc32(described)).to_bytes(CHECKSUM, "little"), described, content))


def unframe(owner: str, framed: bytes) -> bytes:
    """Return the content of :func:`frame`; raises UserError where it is damaged or another owner's."""
    if not isinstance(framed, bytes):
        raise UserError(f"{framed!r} was given as a saved state; allowed: bytes that were saved")
    if len(framed) < HEAD or framed[: len(MAGIC)] != MAGIC:
        raise UserError(f"{len(framed)} bytes were given as a saved state; they are none of this version of mbfmu")
    length = int.from_bytes(framed[DESCRIBED + OWNER : HEAD], "little")
    if length != len(framed) - HEAD:
        raise UserError(f"a saved state of {length} bytes has {len(framed) - HEAD}: it is damaged")
    if crc32(memoryview(framed)[DESCRIBED:]) != int.from_bytes(framed[len(MAGIC) : DESCRIBED], "little"):
        raise UserError("a saved state is damaged: its checksum does not fit")
    if framed[DESCRIBED : DESCRIBED + OWNER] != _digest(owner):
        raise UserError(
            "a saved state is that of another model, of other parameters that are fixed, or of another solver"
        )
    return framed[HEAD:]


def _digest(owner: str) -> bytes:
    return blake2b(owner.encode(), digest_size=OWNER).digest()
