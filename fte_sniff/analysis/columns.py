"""Owns the way from rows to the contract's columns, as a polars frame.

It must not know who asks or where the frame goes, nor where values stand (`fields` does). Names,
order and words come from `protocol.COLUMNS`; numpy reads one field in all rows at once, so that the
cost of a row is far below a Python loop over its fields.

    time                        Datetime("ns", "UTC"), null where the input has no time
    port, raw                   String (raw: hex, upper case, no spaces)
    direction, kind, status     Enum of the column's words
    faults                      List(String), empty where nothing is wrong
    every other                 Int64, null where the row has no such value
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import polars as pl

from fte_sniff.analysis.fields import Bools, Codes, field_values, kinds_of, timed
from fte_sniff.analysis.packing import FRAMED, Codebook, Packed, pack
from fte_sniff.protocol import (
    COLUMN_BY_NAME,
    COLUMNS,
    FRAME_LENGTH,
    HEADERS,
    KINDS,
    VALUE_FIELDS,
    ColumnType,
    Direction,
    Row,
    status_of,
)
from fte_sniff.protocol.table import CMD_PLACE

_NO_DIRECTION: Final = len(Direction)
_POLARS_TYPE: Mapping[ColumnType, Callable[[Sequence[str]], pl.DataType]] = {
    ColumnType.TIME: lambda _: pl.Datetime("ns", "UTC"),
    ColumnType.TEXT: lambda _: pl.String(),
    ColumnType.WORD: lambda words: pl.Enum([str(word) for word in words]),
    ColumnType.WORDS: lambda _: pl.List(pl.String()),
    ColumnType.INT: lambda _: pl.Int64(),
    ColumnType.HEX: lambda _: pl.String(),
}

SCHEMA: Final[Mapping[str, pl.DataType]] = {
    column.name: _POLARS_TYPE[column.type](column.words) for column in COLUMNS
}
"""The polars type of every column of the row contract, in its order."""


def _direction_codes() -> Codes:
    codes = np.full(256, _NO_DIRECTION, np.uint8)
    for code, direction in enumerate(Direction):
        codes[HEADERS[direction]] = code
    return codes


_DIRECTION_CODES: Final = _direction_codes()
_FIELD_NAMES: Final = frozenset(field.name for field in VALUE_FIELDS)
_HEX_DIGITS: Final = np.array([f"{byte:02X}" for byte in range(256)], "S2")


def row_frame(rows: Sequence[Row], names: Collection[str] | None = None) -> pl.DataFrame:
    """The rows as a frame with the contract's names and types, in the contract's order.

    Args:
        rows: any rows, of any ports, in any order.
        names: only these columns, where not all are needed.
    """
    codebook = Codebook()
    packed, long = pack(rows, codebook)
    return packed_frame(packed, long, codebook, names)


def packed_frame(
    packed: Packed,
    long: Mapping[int, bytes],
    codebook: Codebook,
    names: Collection[str] | None = None,
) -> pl.DataFrame:
    """The same from packed rows; `long` holds the bytes of long rows by place in `packed`."""
    columns = _Columns(packed, long, codebook)
    wanted = (name for name in COLUMN_BY_NAME if names is None or name in names)
    return pl.DataFrame([columns.series(name) for name in wanted])


class _Columns:
    """Makes the columns of one array of packed rows, each when it is asked for."""

    def __init__(self, packed: Packed, long: Mapping[int, bytes], codebook: Codebook) -> None:
        self._packed = packed
        self._long = long
        self._codebook = codebook
        self._raw = np.ascontiguousarray(packed["raw"])
        self._framed: Bools = (packed["form"] & FRAMED).astype(np.bool_)
        self._kinds = kinds_of(packed)

    def series(self, name: str) -> pl.Series:
        """The column of that name."""
        if name in _FIELD_NAMES:
            return self._field(name)
        return _MAKERS[name](self).rename(name)

    def _time(self) -> pl.Series:
        return _known(self._packed["t_ns"], timed(self._packed)).cast(SCHEMA["time"])

    def _port(self) -> pl.Series:
        # A device path may hold bytes that are no text; polars takes valid Unicode alone.
        ports = [port.encode(errors="replace").decode() for port in self._codebook.ports]
        return _looked_up(ports, self._packed["port"], pl.String())

    def _number(self, name: str) -> pl.Series:
        return pl.Series(self._packed[name].astype(np.int64))

    def _direction(self) -> pl.Series:
        codes = np.where(self._framed, _DIRECTION_CODES[self._raw[:, 0]], _NO_DIRECTION)
        return _looked_up([*map(str, Direction), None], codes, SCHEMA["direction"])

    def _kind(self) -> pl.Series:
        return _looked_up([*(kind.name for kind in KINDS), None], self._kinds, SCHEMA["kind"])

    def _cmd(self) -> pl.Series:
        return _known(self._raw[:, CMD_PLACE], self._framed)

    def _field(self, name: str) -> pl.Series:
        values, known = field_values(self._raw, self._kinds, name)
        return _known(values, known).rename(name)

    def _status(self) -> pl.Series:
        words = [status_of(faults).value for faults in self._codebook.faults]
        return _looked_up(words, self._packed["faults"], SCHEMA["status"])

    def _faults(self) -> pl.Series:
        words = [[fault.value for fault in faults] for faults in self._codebook.faults]
        return _looked_up(words, self._packed["faults"], SCHEMA["faults"])

    def _hex(self) -> pl.Series:
        digits = _HEX_DIGITS[self._raw].view(f"S{2 * FRAME_LENGTH}").reshape(-1)
        texts = pl.Series(digits, dtype=pl.Binary()).cast(pl.String())
        lengths = self._packed["length"]
        odd = np.flatnonzero(lengths != FRAME_LENGTH)
        if not odd.size:
            return texts
        return texts.scatter(pl.Series(odd), pl.Series(list(self._odd_hex(odd.tolist()))))

    def _odd_hex(self, places: Sequence[int]) -> Iterator[str]:
        for at in places:
            length = int(self._packed["length"][at])
            long = length > FRAME_LENGTH
            raw = self._long[at] if long else self._raw[at, :length].tobytes()
            yield raw.hex().upper()


_MAKERS: Final[Mapping[str, Callable[[_Columns], pl.Series]]] = {
    "time": _Columns._time,
    "port": _Columns._port,
    "offset": partial(_Columns._number, name="offset"),
    "length": partial(_Columns._number, name="length"),
    "direction": _Columns._direction,
    "kind": _Columns._kind,
    "cmd": _Columns._cmd,
    "status": _Columns._status,
    "faults": _Columns._faults,
    "raw": _Columns._hex,
}


def _known(values: npt.NDArray[Any], known: Bools) -> pl.Series:
    """The values as Int64, null where they are not known."""
    series = pl.Series(values.astype(np.int64))
    return series if known.all() else series.zip_with(pl.Series(known), _NULL)


def _looked_up(words: Sequence[object], codes: npt.NDArray[Any], dtype: pl.DataType) -> pl.Series:
    return pl.Series(words, dtype=dtype).gather(pl.Series(codes.astype(np.uint32)))


_NULL: Final = pl.Series([None], dtype=pl.Int64())
