"""Owns the search for a text in rows: which of many packed rows have it, and where in a shown text.

It must not know a screen, nor which rows are shown. Looked at is what people see of a row, in small
letters, in columns that a table has, also those it has no room for at the moment:

    12:00:00.000435123 ttyUSB0 speed motor=1 rpm=1000 bad_tail 12340

and its bytes: `aa 01` and `AA01` are two bytes side by side, and a text at the same time. Behind
`hex:` stand bytes alone, where `?` is any digit: `hex:AA 02 ??03`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.columns.packing import Codebook, Packed
from fte_sniff.errors import InputTextError, shown
from fte_sniff.protocol import COLUMN_BY_NAME, FRAME_LENGTH

Bools = npt.NDArray[np.bool_]

HEX: Final = "hex:"
"""What stands before bytes that are not to be taken for a text."""

_BYTES: Final = re.compile(r"(?:[0-9a-f]{2} ?)+")
_NIBBLES: Final = re.compile(r"(?:[0-9a-f?]{2} ?)+")


@dataclass(frozen=True, slots=True)
class Search:
    """What is looked for; made by `parse`."""

    typed: str
    """As typed."""
    text: str
    """In small letters; empty where only bytes are meant."""
    nibbles: str
    """The bytes as hex digits, two a byte, `?` where any will do; empty where none are meant."""
    pattern: re.Pattern[str]
    """Finds either in a shown text."""

    @classmethod
    def parse(cls, typed: str) -> Search:
        """What a line says that is not empty.

        Raises:
            InputTextError: it begins like bytes and is none.
        """
        line = " ".join(typed.split()).lower()
        if line.startswith(HEX):
            digits = line.removeprefix(HEX).strip()
            if not _NIBBLES.fullmatch(digits):
                raise InputTextError(
                    f"'{shown(digits)}' is not hex: two digits a byte, as in hex:AA 02 ??03"
                )
            return cls._made(typed, "", digits)
        return cls._made(typed, line, line if _BYTES.fullmatch(line) else "")

    @classmethod
    def _made(cls, typed: str, text: str, digits: str) -> Search:
        nibbles = digits.replace(" ", "")
        pairs = [nibbles[at : at + 2] for at in range(0, len(nibbles), 2)]
        spaced = " ".join(pair.replace("?", "[0-9a-f]") for pair in pairs)
        ways = [re.escape(text)] if text else []
        ways += [rf"\b{spaced}\b"] if spaced else []
        return cls(typed, text, nibbles, re.compile("|".join(ways), re.IGNORECASE))

    def places(self, text: str) -> list[tuple[int, int]]:
        """Where in a shown text it stands: starts and ends, rising, none of them empty."""
        return [match.span() for match in self.pattern.finditer(text) if match.group()]

    def mask(
        self,
        packed: Packed,
        long: Mapping[int, bytes],
        codebook: Codebook,
        columns: Collection[str] = COLUMN_BY_NAME,
    ) -> Bools:
        """For every packed row whether it has what is looked for.

        Args:
            packed: the rows.
            long: their bytes where they are too many for a packed row, by place.
            codebook: the words of packed rows.
            columns: those that a table has; a port, time or offset that no column tells is not
                looked at. Kind, values, faults and bytes are told in any.
        """
        found: Bools = np.zeros(len(packed), np.bool_)
        if self.nibbles:
            found |= self._has_bytes(packed, long)
        if self.text:
            if "port" in columns:
                found |= self._told(codebook.ports)[packed["port"]]
            found |= self._told([",".join(faults) for faults in codebook.faults])[packed["faults"]]
            # It needs polars, which takes long to load; a screen begins without a search.
            from fte_sniff.analysis.store.search_texts import tell

            found |= tell(self.text, columns, packed, long, codebook)
        return found

    def _told(self, texts: Sequence[str]) -> Bools:
        return np.array([self.text in shown(text).lower() for text in texts], np.bool_)

    def _has_bytes(self, packed: Packed, long: Mapping[int, bytes]) -> Bools:
        wanted, care = _byte_pattern(self.nibbles)
        raw, found = packed["raw"], np.zeros(len(packed), np.bool_)
        size = len(wanted)
        for start in range(FRAME_LENGTH - size + 1):
            same = ((raw[:, start : start + size] ^ wanted) & care == 0).all(axis=1)
            found |= same & (packed["length"] >= start + size)
        expression = re.compile(_bytes_expression(self.nibbles), re.DOTALL)
        for place, whole in long.items():
            found[place] = expression.search(whole) is not None
        return found


def _byte_pattern(nibbles: str) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """The bytes, and which of their bits count."""
    wanted = bytes.fromhex(nibbles.replace("?", "0"))
    care = bytes.fromhex("".join("0" if digit == "?" else "f" for digit in nibbles))
    return np.frombuffer(wanted, np.uint8), np.frombuffer(care, np.uint8)


def _bytes_expression(nibbles: str) -> bytes:
    wanted, care = _byte_pattern(nibbles)
    return b"".join(
        b"[" + b"".join(re.escape(bytes((b,))) for b in range(256) if (b ^ w) & c == 0) + b"]"
        for w, c in zip(wanted.tolist(), care.tolist(), strict=True)
    )
