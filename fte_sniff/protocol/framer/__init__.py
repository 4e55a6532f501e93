"""The framer: a port's chunks in, rows out, every byte in exactly one of them.

It must not know where chunks come from or who wants the rows. What is beyond doubt is a row at
once; the rest, a disputed stretch, is weighed as a whole. From what the framer is told to what it
says:

    framer       Framer: the bytes at hand, and what is done with them next
    patterns     the regular expressions that find frames
    timeline     the times of bytes, and silence
    undisputed   damage that has one reading only
    enclosed     what stands before a frame beyond doubt
    due          when a disputed stretch is weighed, and how much of it is decided then
    likelihood   the cost model: how likely frames, damage and noise are
    ends         what the front and the back of a damaged frame weigh
    pieces       what can begin at a place of a disputed stretch
    weighing     how probable frames are in it
    choice       which reading of it is chosen, and what doubt remains
    gap          how what lies between its frames is divided
    reading      a decided stretch, in parts
    decided      what becomes of decided parts, and what they tell of the line
    tiling       decided bytes to rows
    keeping      decided bytes as tiles, for much at once

All but this file is compiled where fte-sniff is installed with a C compiler at hand (`setup.py`);
elsewhere the same source is interpreted.
"""

from fte_sniff.protocol.framer import framer as _framer
from fte_sniff.protocol.framer.framer import Framer

__all__ = ["COMPILED", "Framer"]

COMPILED: bool = not _framer.__file__.endswith((".py", ".pyc"))
"""Whether what runs here was compiled."""
