"""Owns what goes wrong with bytes on their way to the listener: lost, flipped, and noise.

It must not know what the bytes mean. Each kind of fault has dice of its own, so that asking for one
leaves the places of the others as they are.
"""

from __future__ import annotations

from random import Random

MOST_DROPPED = 4
"""Adjacent bytes lost at most in one fault."""

MOST_NOISE = 8
"""Random bytes at most between two frames."""


class Faults:
    """Damages frames with the probabilities asked for."""

    def __init__(self, seed: int, drop: float, flip: float, noise: float) -> None:
        self._drop, self._flip, self._noise = drop, flip, noise
        self._drop_dice = Random(f"{seed}/drop")
        self._flip_dice = Random(f"{seed}/flip")
        self._noise_dice = Random(f"{seed}/noise")

    def damaged(self, raw: bytes) -> bytes:
        """The bytes as they are heard; at least one is left."""
        if _below(self._flip_dice, self._flip):
            raw = self._with_a_bit_flipped(raw)
        if _below(self._drop_dice, self._drop):
            raw = self._with_bytes_lost(raw)
        return raw

    def noise(self) -> bytes:
        """What is heard before the next frame; mostly nothing."""
        dice = self._noise_dice
        if not _below(dice, self._noise):
            return b""
        return bytes(_whole(dice, 256) for _ in range(1 + _whole(dice, MOST_NOISE)))

    def _with_a_bit_flipped(self, raw: bytes) -> bytes:
        place, bit = divmod(_whole(self._flip_dice, len(raw) * 8), 8)
        return raw[:place] + bytes([raw[place] ^ 1 << bit]) + raw[place + 1 :]

    def _with_bytes_lost(self, raw: bytes) -> bytes:
        count = 1 + _whole(self._drop_dice, min(MOST_DROPPED, len(raw) - 1))
        first = _whole(self._drop_dice, len(raw) - count + 1)
        return raw[:first] + raw[first + count :]


def _below(dice: Random, probability: float) -> bool:
    return dice.random() < probability


def _whole(dice: Random, end: int) -> int:
    """A whole number from 0 up to but not `end`; `random()` alone is the same in every Python."""
    return int(dice.random() * end)
