"""The framer: the chunks of a port in, rows out, with every byte in exactly one row.

Modules:

    framer  Times, silence, rows.
    walk    Islands of frames in step, and the gaps between them.
    gap     How gaps are divided into frames, damage and noise.
"""

from fte_sniff.protocol.islands.framer import Framer

__all__ = ["Framer"]
