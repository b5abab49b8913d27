"""States as plain values and as bytes, and how they are read again."""

from phdtrack.state.binary import blocks, from_bytes, to_bytes
from phdtrack.state.forms import World, held_moments
from phdtrack.state.reading import pack, restored

__all__ = ["World", "blocks", "from_bytes", "held_moments", "pack", "restored", "to_bytes"]
