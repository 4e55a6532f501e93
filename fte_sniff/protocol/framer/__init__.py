"""The framer: the chunks of a port in, rows out, with every byte in exactly one row.

Certain frames become rows at once. Anything else, a disputed span, is decoded with a hidden
semi-Markov model; `docs/framer.md` explains it with an example. Modules:

    framer       Framer: feed chunks, get rows; decides when enough bytes have arrived.
    timestamps   Arrival time and read delay of a byte; pauses and silence on the line.
    tables       Lookup tables of a frame format; fault sets.
    reserve      What a line has in its reserve bytes, learned from its frames.
    predicates   Tests of a window of bytes: framed, legal, readable in one way only.
    likelihood   Likelihood model: scores of frames, damaged frames and noise.
    candidates   Candidate frames and damaged frames of a span, with their scores.
    posterior    Forward-backward algorithm: posterior probabilities, boundary state.
    decoder      Viterbi segmentation of a disputed span; fast paths for clear damage.
    segments     Decided segments, the health of the line, and rows made of segments.

The code is written for mypyc: machine integers (`i64`), arrays (`vec[float]`), and loops over
single bytes compile to few instructions. All modules but this one are compiled where fte-sniff is
installed with a C compiler (`setup.py`); elsewhere the same source is interpreted.
"""

from fte_sniff.protocol.framer import framer as _framer
from fte_sniff.protocol.framer.framer import Framer
from fte_sniff.protocol.framer.tables import FTE_TABLES, FrameTables

__all__ = ["COMPILED", "FTE_TABLES", "FrameTables", "Framer"]

COMPILED: bool = not _framer.__file__.endswith((".py", ".pyc"))
"""Whether the framer is compiled."""
