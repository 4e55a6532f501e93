"""Owns that a class of the screen may leave methods to those derived from it, and is none itself.

Textual's classes have a metaclass of their own, so that `abc.ABC` cannot stand beside them.
"""

from __future__ import annotations

from abc import ABCMeta

from textual.message_pump import _MessagePumpMeta


class AbstractMeta(_MessagePumpMeta, ABCMeta):
    """The metaclass of Textual's classes that have abstract methods."""
