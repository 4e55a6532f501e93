"""The framer: a port's chunks in, rows out, every byte in exactly one of them.

It must not know where chunks come from or who wants the rows. What is beyond doubt is a row at
once; the rest, a disputed stretch, is weighed as a whole. From what the framer is told to what it
says:

    framer       Framer: feed chunks, get rows; decides when enough bytes have arrived
    timestamps   arrival time and read delay of a byte; silence on the line
    tables       the frame definitions as lookup tables
    predicates   tests of a window of bytes: framed, fits a kind, beyond doubt
    likelihood   log-likelihood of frames, damaged frames and noise
    candidates   candidate frames and damaged frames that begin at an offset
    posterior    forward-backward pass over a disputed span
    decoder      Viterbi segmentation of a disputed span; fast paths for clear damage
    segments     decided segments, what they say about the line, and rows made of them

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
