"""The framer: the chunks of a port in, rows out, with every byte in exactly one row.

Certain frames become rows at once. Anything else, a disputed span, is decoded with a hidden
semi-Markov model; `docs/framer.md` explains it with an example. Modules:

    framer       Framer: feed chunks, get rows; decides when enough bytes have arrived; times.
    decoder      Decoding of a disputed span: candidates, posterior probabilities, segmentation.
    model        What bytes a frame may have, how probable they are, and the reserve of a line.

The code is written for mypyc: machine integers (`i64`), arrays (`vec[float]`), and loops over
single bytes compile to few instructions. All modules but this one are compiled where fte-sniff is
installed with a C compiler (`setup.py`); elsewhere the same source is interpreted.
"""

from fte_sniff.protocol.framer import framer as _framer
from fte_sniff.protocol.framer.framer import Framer
from fte_sniff.protocol.framer.model import FTE_TABLES, FrameTables

__all__ = ["COMPILED", "FTE_TABLES", "FrameTables", "Framer"]

COMPILED: bool = not _framer.__file__.endswith((".py", ".pyc"))
"""Whether the framer is compiled."""
