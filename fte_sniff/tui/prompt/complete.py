"""Owns what the filter field suggests: the line as it would be with its last word completed.

It must not know the filter's language; `analysis` does.
"""

from __future__ import annotations

from collections.abc import Callable

from textual.suggester import Suggester


def completed(line: str, t_ns: int | None = None) -> str | None:
    """The line with the likeliest rest of its last word, or None where nothing fits behind it.

    `t_ns` is a time to go by where one is asked for.
    """
    if not line.strip():
        return None
    # It is loaded with the filter, once one is asked for; a screen begins sooner without.
    from fte_sniff.analysis.filter.completion import completions

    found = completions(line, t_ns=t_ns)
    wholes = (line[: found.start] + choice for choice in found.choices)
    return next((whole for whole in wholes if whole.lower().startswith(line.lower())), None)


class WordSuggester(Suggester):
    """Suggests the rest of a name, a sign or a value."""

    def __init__(self, time_here: Callable[[], int | None]) -> None:
        """`time_here` tells the time to go by, if there is one."""
        super().__init__(use_cache=False, case_sensitive=True)
        self._time_here = time_here

    async def get_suggestion(self, value: str) -> str | None:
        """The whole line as it would be."""
        return completed(value, self._time_here())
