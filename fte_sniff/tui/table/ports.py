"""Owns the short names of ports: what tells them apart, in few cells.

It must not know what a port is; names come from outside and have gone through `errors.shown`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import takewhile

from rich.cells import cell_len

from fte_sniff.tui.fitting import ELLIPSIS, fit, fit_path

_SEPARATORS = "/\\:?& "


def short_names(names: Sequence[str], width: int) -> dict[str, str]:
    """Each name in at most `width` cells, and no two alike as far as the width allows.

    What all begin with is left out up to the last part of a path. What is still too long is cut in
    its middle; where that would make two alike, at its start; and else each has its number.
    """
    parts = _without_prefix(names)
    ways = (
        [_cut_middle(part, width) for part in parts],
        [fit_path(part, width) for part in parts],
        [fit(part, width).rstrip() for part in parts],
    )
    numbered = [fit(f"{at} {part}", width).rstrip() for at, part in enumerate(parts, 1)]
    chosen = next((way for way in ways if len(set(way)) == len(set(names))), numbered)
    return dict(zip(names, chosen, strict=True))


def _without_prefix(names: Sequence[str]) -> list[str]:
    signs = zip(*names, strict=False) if len(set(names)) > 1 else ()
    common = "".join(sign[0] for sign in takewhile(lambda sign: len(set(sign)) == 1, signs))
    start = 1 + max(common.rfind(separator) for separator in _SEPARATORS)
    parts = [name[start:] for name in names]
    return parts if all(parts) else list(names)


def _cut_middle(text: str, width: int) -> str:
    if cell_len(text) <= width:
        return text
    left = (width - 1) // 2
    return fit(text, left + 1).rstrip(ELLIPSIS).rstrip() + fit_path(text, width - left)
