"""The tools that `fte-sniff decoder` knows, and where each finds a decoder of the user."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from fte_sniff.formats.decoders.json_schema import schema
from fte_sniff.formats.decoders.sigrok import decoder
from fte_sniff.formats.decoders.wireshark import dissector


@dataclass(frozen=True, slots=True)
class Tool:
    """A tool that can decode the protocol."""

    text: Callable[[], str]
    """Makes the decoder's source."""
    path: Callable[[], Path] | None
    """The file that the tool loads; None for a tool without a fixed path."""
    use: str
    """How to use the decoder, in one line."""


def _sigrok_path() -> Path:
    """The decoder in GLib's folder for data of the user, which libsigrokdecode searches."""
    if sys.platform == "win32":
        data = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData/Local")
    else:
        data = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local/share")
    return data / "libsigrokdecode/decoders/fte/__init__.py"


def _wireshark_path() -> Path:
    """The dissector in the folder that Wireshark shows as "Personal Lua Plugins"."""
    if sys.platform == "win32":
        data = Path(os.environ.get("APPDATA") or Path.home() / "AppData/Roaming")
        return data / "Wireshark/plugins/fte.lua"
    return Path.home() / ".local/lib/wireshark/plugins/fte.lua"


TOOLS: Mapping[str, Tool] = MappingProxyType(
    {
        "sigrok": Tool(
            decoder,
            _sigrok_path,
            "add the decoder UART and stack FTE on it; sigrok-cli -P uart:rx=D0:tx=D1,fte -A fte",
        ),
        "wireshark": Tool(
            dissector,
            _wireshark_path,
            "fte-sniff decode capture.mcap -o capture.pcapng && wireshark capture.pcapng",
        ),
        "json-schema": Tool(schema, None, "fte-sniff decoder json-schema > fte-sniff.schema.json"),
    }
)
