"""Former names of `protocol.rows`, until the last module that uses them changes."""

from fte_sniff.protocol.rows import NO_TIME as NO_TIME
from fte_sniff.protocol.rows import Array as Array
from fte_sniff.protocol.rows import Codebook as Codebook
from fte_sniff.protocol.rows import RowBuffer as RowBuffer
from fte_sniff.protocol.rows import Rows as RowBatch

__all__ = ["NO_TIME", "Array", "Codebook", "RowBatch", "RowBuffer"]
