"""Saved states: bytes with a checksum and a format number, and the records made of them again."""

from phdtrack.state.binary import FORMAT, blocks, from_bytes, other_format, to_bytes
from phdtrack.state.unpacking import settings_digest, unpack

__all__ = [
    "FORMAT",
    "blocks",
    "from_bytes",
    "other_format",
    "settings_digest",
    "to_bytes",
    "unpack",
]
