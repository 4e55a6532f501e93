"""Owns lines that logic analysers give of a UART, one byte a line, without a heading.

It must not know what the bytes are.

    uart-1: AA                                   sigrok-cli -A uart=rx-data
    12290-12377 uart-1: rx-data: AA              with --protocol-decoder-samplenum and -ann-class
    12290-12377 UART: RX data: AA                PulseView
    > \t0xaa                                      interceptty
"""

from __future__ import annotations

import re
from collections.abc import Callable

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.line_head import Mark
from fte_sniff.formats.logs.own_lines import OwnLine

_SIGROK = re.compile(
    r"\s*(?:\d+-\d+\s+)?(?P<decoder>uart-\d+|UART(?:[ -]\(?\d+\)?)?)\s*:\s*"
    r"(?:(?P<kind>[A-Za-z][\w /-]*?)\s*:\s*)?(?P<value>.*?)\s*"
)
_INTERCEPTTY = re.compile(r"\s*[<>]\s+0x(?P<value>[0-9a-fA-F]{2})\s+\(.*\)\s*")
_VALUES = {
    **dict.fromkeys(("rx-data", "rx data", "rx"), Mark.RECEIVED),
    **dict.fromkeys(("tx-data", "tx data", "tx"), Mark.SENT),
}
_BYTE = re.compile(r"[0-9A-Fa-f]{2}")
_BIT = re.compile(r"[01]|(?:start|stop|parity) bit", re.IGNORECASE)
_BITS = re.compile(r"bit|start|stop|packet|parity-ok", re.IGNORECASE)
_TROUBLE = re.compile(r"(?:frame|parity|framing) error|break(?: condition)?|warning", re.IGNORECASE)


class Annotations:
    """Reads them; they are to be of one decoder, so that they are of one wire."""

    def __init__(self, note: Callable[[str], None]) -> None:
        """No line is read yet; `note` is told of errors on the wire."""
        self._note = note
        self._decoder: str | None = None
        self._told = False

    def own_line(self, text: str, number: int) -> OwnLine | None:
        """What a line holds; None where it is no annotation.

        Raises:
            InputTextError: it is of another decoder, or its value is not in hex.
        """
        if "uart" not in text and "UART" not in text and text[:1] not in "<>":
            return None
        if one := _INTERCEPTTY.fullmatch(text):
            return OwnLine(_only(text, one.span("value")))
        found = _SIGROK.fullmatch(text)
        if found is None:
            return None
        kind, value = (found["kind"] or "").lower(), found["value"]
        if self._decoder not in (None, found["decoder"]):
            raise InputTextError(
                f"line {number}: {found['decoder']} is another decoder than {self._decoder} above;"
                " keep the lines of one wire"
            )
        self._decoder = found["decoder"]
        if _BYTE.fullmatch(value) and kind in ("", *_VALUES):
            return OwnLine(_only(text, found.span("value")), None, _VALUES.get(kind))
        if _TROUBLE.search(value) or _TROUBLE.search(kind.replace("-", " ")):
            self._tell(f"line {number}: {value or kind}, as the analyser says")
            return OwnLine("")
        if _BITS.search(kind) or (not kind and _BIT.fullmatch(value)):
            return OwnLine("")
        raise InputTextError(
            f"line {number}: {value!r} is no byte in hex; export again with hex values (sigrok-cli:"
            " uart:format=hex, -A uart=rx-data)"
        )

    def _tell(self, trouble: str) -> None:
        if not self._told:
            self._told = True
            self._note(trouble)


def _only(text: str, span: tuple[int, int]) -> str:
    start, stop = span
    return " " * start + text[start:stop]
