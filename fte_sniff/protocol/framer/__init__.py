"""The framer: a port's chunks in, rows out, every byte in exactly one of them.

It must not know where chunks come from or who wants the rows. What is beyond doubt is a row at
once; the rest, a disputed stretch, is weighed as a whole. From what the framer is told to what it
says:

    framer       Framer: the bytes at hand, and what is done with them next
    timeline     the times of bytes, and silence
    places       the frame table as it is looked up: by kind, place and byte
    shapes       what stands at a place: ten framed bytes, a frame that fits, one beyond doubt
    undisputed   damage that has one reading only
    enclosed     what stands before a frame beyond doubt
    due          when a disputed stretch is weighed, and how much of it is decided then
    likelihood   the cost model: how likely frames, damage and noise are
    noise        what noise weighs, by its length
    ends         what the front and the back of a damaged frame weigh
    pieces       what can begin at a place of a disputed stretch
    carry        what the bytes before a stretch say about it
    weighing     how probable frames are in it
    choice       which reading of it is chosen, and what doubt remains
    gap          how what lies between its frames is divided
    reading      a decided stretch, in parts
    fault_sets   the faults of a part, as a number
    line         what becomes of decided parts, and what they tell of the line
    tiling       decided bytes as tiles: which are one row each, and which are runs of frames
    keeping      what was decided, with its bytes and times, until somebody takes it as rows or more

Numbers are machine numbers here (`i64`, and `vec[float]` for many), and loops go byte by byte: what
reads slow in Python is what compiles to the fewest instructions.
All but this file is compiled where fte-sniff is installed with a C compiler at hand (`setup.py`);
elsewhere the same source is interpreted.
"""

from fte_sniff.protocol.framer import framer as _framer
from fte_sniff.protocol.framer.framer import Framer

__all__ = ["COMPILED", "Framer"]

COMPILED: bool = not _framer.__file__.endswith((".py", ".pyc"))
"""Whether what runs here was compiled."""
