"""Colours of the table: contrast, and looks that need no colours."""

from __future__ import annotations

from itertools import pairwise
from math import dist

import pytest
from rich.color import Color, ColorSystem
from rich.console import Console
from rich.segment import Segment
from rich.style import Style
from textual.color import Color as TextualColor
from textual.color import rgb_to_lab
from textual.theme import BUILTIN_THEMES, Theme

from fte_sniff.protocol import KINDS, Fault, Row, Status, encode
from fte_sniff.protocol.columns import LOOKS, Ground
from fte_sniff.protocol.dissect import byte_names
from fte_sniff.tui.cells import RAISED_MARK
from fte_sniff.tui.i18n import THEMES
from fte_sniff.tui.painter import (
    BAR_EVENT,
    BAR_MARKED,
    BAR_RAISED,
    CONTRAST_THEMES,
    EVENT_SIGN,
    REVERSED,
    SHADES,
    BarSign,
    Colors,
    Palette,
    ReadableColors,
    Sign,
    over_line,
    palette_of,
)
from fte_sniff.tui.panes.row import dump

ALL_THEMES = {theme.name: theme for theme in CONTRAST_THEMES} | BUILTIN_THEMES
FRAMES = {
    kind.name: Row("p", 0, encode(kind, {f.name: 1 for f in kind.fields if not f.legal_bits}), 1)
    for kind in KINDS
}


def luminance(color: Color) -> float:
    parts = [part / 255 for part in color.get_truecolor()]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(style: Style, background: str) -> float:
    """The ratio of WCAG 2: 1 to 21."""
    assert style.color
    one, other = luminance(style.color), luminance(style.bgcolor or Color.parse(background))
    return (max(one, other) + 0.05) / (min(one, other) + 0.05)


def background_of(theme: Theme) -> str:
    return theme.background or ("#121212" if theme.dark else "#E0E0E0")


@pytest.mark.parametrize("name", THEMES)
def test_bytes_have_contrast_under_every_theme(name: str) -> None:
    theme = ALL_THEMES[name]
    palette, background = palette_of(theme), background_of(theme)
    low = {
        name: round(ratio, 1)
        for name, style in {**palette.fields, **dict(enumerate(palette.changed))}.items()
        if (ratio := contrast(style, background)) < (3.0 if name == "reserve" else 4.5)
    }
    assert not low


WRONG = (Status.SUSPECT, Status.MALFORMED)


def signs_of(palette: Palette) -> list[Style]:
    texts = [palette.raised, *(palette.statuses[status] for status in WRONG)]
    return [*texts, palette.raised_mark, *(palette.marks[status] for status in WRONG)]


@pytest.mark.parametrize("name", THEMES)
def test_signs_of_rows_have_contrast_under_every_theme(name: str) -> None:
    theme = ALL_THEMES[name]
    for style in signs_of(palette_of(theme)):
        assert contrast(style, background_of(theme)) >= 4.5


@pytest.mark.parametrize(
    ("ground", "page"), [(Ground.LIGHT, "#ffffff"), (Ground.DARK, "#161a20")], ids=["light", "dark"]
)
def test_looks_have_contrast_on_a_page(ground: Ground, page: str) -> None:
    for look in LOOKS.values():
        assert contrast(Style(color=look.plot), page) >= 2.9
    for status in WRONG:
        assert contrast(Style(color=LOOKS[status].inks[ground].text), page) >= 4.5


@pytest.mark.parametrize(("name", "background"), [("textual-dark", 0), ("textual-light", 15)])
def test_signs_of_rows_have_contrast_in_16_colours(name: str, background: int) -> None:
    for style in signs_of(palette_of(ALL_THEMES[name], Colors.SIXTEEN)):
        assert style.color
        colors = [style.color, style.bgcolor or Color.parse(f"color({background})")]
        text, behind = (in_16_colours(color) for color in colors)
        assert contrast(Style(color=text), behind.name) >= 4.5


def in_16_colours(color: Color) -> Color:
    """The colour as a terminal of 16 colours draws it."""
    return Color.from_triplet(color.downgrade(ColorSystem.STANDARD).get_truecolor())


XTERM = "000000 cd0000 00cd00 cdcd00 0000ee cd00cd 00cdcd e5e5e5 7f7f7f ff0000 00ff00 ffff00"
XTERM_16 = f"{XTERM} 5c5cff ff00ff 00ffff ffffff".split()
"""The 16 colours of xterm, which are brighter than those of rich."""


@pytest.mark.parametrize(("name", "ground"), [("textual-dark", 0), ("textual-light", 15)])
def test_texts_are_readable_in_16_colours_and_none_has_that_of_damage(
    name: str, ground: int
) -> None:
    palette = palette_of(ALL_THEMES[name], Colors.SIXTEEN)
    texts = {
        **{name: getattr(palette, name) for name in ("muted", "target", "signs")},
        **palette.kinds,
        **palette.values,
        **palette.fields,
    }
    damage = in_16_colours(palette.statuses[Status.MALFORMED].color or Color.default())
    for text, style in texts.items():
        assert style.color
        assert in_16_colours(style.color) != damage, text
        number = style.color.downgrade(ColorSystem.STANDARD).number
        assert number is not None
        for color, background in (
            (in_16_colours(style.color), Color.parse(f"color({ground})")),
            (Color.parse(f"#{XTERM_16[number]}"), Color.parse(f"#{XTERM_16[ground]}")),
        ):
            # The grey of xterm on white has 4.0.
            least = 3.9 if number == 8 else 4.5
            assert contrast(Style(color=color), background.name) >= least, text


@pytest.mark.parametrize("text", range(16))
@pytest.mark.parametrize("ground", range(16))
def test_text_is_readable_among_16_colours_on_any_background(text: int, ground: int) -> None:
    style = Style.parse(f"color({text}) on color({ground})")
    ((_, shown, _),) = ReadableColors().apply([Segment("x", style)], TextualColor(0, 0, 0))
    assert shown is not None
    assert shown.bgcolor == style.bgcolor
    assert shown.color
    assert shown.bgcolor
    one, other = (in_16_colours(color) for color in (shown.color, shown.bgcolor))
    assert contrast(Style(color=one, bgcolor=other), "") >= 3.0
    if contrast(Style(color=in_16_colours(style.color), bgcolor=other), "") >= 3:  # type: ignore[arg-type]
        assert shown == style


@pytest.mark.parametrize("name", THEMES)
@pytest.mark.parametrize("colors", [Colors.ALL, Colors.SIXTEEN])
def test_fault_stands_out_in_the_bytes_of_the_cursors_row(name: str, colors: Colors) -> None:
    palette = palette_of(ALL_THEMES[name], colors)
    raw = bytes.fromhex("AA0101FF7000000000E6")
    damage = Row("p", 0, raw, 1, (Fault.BAD_TAIL,), framed=False)
    for row in (damage, FRAMES["speed_feedback"]):
        page = dump(row, [row], 80, palette)
        start = page.plain.index("<") + 1
        shown = [page.get_style_at_offset(Console(), start + 3 * at) for at in range(len(row.raw))]
        for byte, own in zip(shown, palette.of_bytes(row), strict=True):
            if own.bgcolor or own.reverse:
                assert (byte.bgcolor, byte.reverse) == (own.bgcolor, own.reverse)
                assert own.color in (None, byte.color)
            elif colors is Colors.ALL:
                assert byte.bgcolor == palette.cursor_row.bgcolor
                least = 3.0 if own == palette.faint else 4.4
                assert contrast(byte, "") >= least
    assert any(own.bgcolor or own.reverse for own in palette.of_bytes(damage))


@pytest.mark.parametrize("name", THEMES)
def test_changed_bytes_differ_from_all_other_highlighted_bytes(name: str) -> None:
    palette = palette_of(ALL_THEMES[name])
    marks = [palette.marks[Status.MALFORMED], palette.marks[Status.SUSPECT]]
    others = [*marks, palette.raised_mark, palette.found, palette.field]
    for changed in palette.changed:
        for other in others:
            if changed.bgcolor is not None:
                assert other.bgcolor is not None
                assert distance(changed.bgcolor, other.bgcolor) >= 20


def distance(one: Color, other: Color) -> float:
    """Distance of two colours in CIE Lab; 100 from black to white."""
    labs = [rgb_to_lab(TextualColor(*color.get_truecolor())) for color in (one, other)]
    return dist(*((lab.L, lab.a, lab.b) for lab in labs))


@pytest.mark.parametrize("name", THEMES)
@pytest.mark.parametrize("colors", [Colors.SIXTEEN, Colors.NONE])
def test_row_under_the_cursor_is_reversed_where_there_are_few_colours(
    name: str, colors: Colors
) -> None:
    palette = palette_of(ALL_THEMES[name], colors)
    line = Style(color="#ffffff", bgcolor="#000000") + REVERSED
    texts = [*palette.fields.values(), *palette.kinds.values(), *palette.statuses.values()]
    for style in texts:
        shown = over_line(line, style)
        assert (shown.color, shown.bgcolor, shown.reverse) == (line.color, line.bgcolor, True)
        assert bool(shown.underline) == bool(style.underline)
    boxed = [palette.marks[Status.MALFORMED], palette.raised_mark, palette.found, REVERSED]
    for style in boxed:
        shown = over_line(line, style)
        assert not shown.reverse
        assert shown.bgcolor == (style.bgcolor or line.bgcolor)


@pytest.mark.parametrize("kind", FRAMES)
@pytest.mark.parametrize("theme", ["textual-dark", "textual-light"])
@pytest.mark.parametrize("colors", [Colors.SIXTEEN, Colors.NONE])
def test_adjacent_fields_differ_with_few_colours(kind: str, theme: str, colors: Colors) -> None:
    styles = palette_of(ALL_THEMES[theme], colors).of_bytes(FRAMES[kind])
    if colors is Colors.NONE:
        styles = [style.without_color for style in styles]
    names = byte_names(FRAMES[kind].kind)  # type: ignore[arg-type]
    framing = {"header", "tail", "num", "reserve"}
    for (name, style), (other, next_style) in pairwise(zip(names, styles, strict=True)):
        if name != other and not {name, other} <= framing:
            assert style != next_style, (name, other)


@pytest.mark.parametrize("colors", Colors)
def test_the_byte_with_the_fault_stands_out(colors: Colors) -> None:
    palette = palette_of(ALL_THEMES["textual-dark"], colors)
    raw = bytes.fromhex("AA010103E80007000 0EE".replace(" ", ""))
    frame = Row("p", 0, raw, 1, (Fault.RESERVED_NONZERO,))
    sound = palette.of_bytes(Row("p", 0, bytes.fromhex("AA010103E800000000EE"), 1))
    differing = [
        at
        for at, pair in enumerate(zip(sound, palette.of_bytes(frame), strict=True))
        if pair[0] != pair[1]
    ]
    assert differing == [5, 6, 7, 8]
    damage = Row("p", 0, raw[:-1] + b"\xef", 1, (Fault.BAD_TAIL,), framed=False)
    *others, tail = palette.of_bytes(damage)
    assert len(set(others)) == 1
    assert tail.without_color not in others if colors is Colors.NONE else tail not in others
    raised = bytes.fromhex("550101000000000409EE")
    *_, error, online, _tail = palette.of_bytes(Row("p", 0, raised, 1))
    assert error == online
    assert error.reverse or error.bgcolor


@pytest.mark.parametrize("name", [*THEMES])
@pytest.mark.parametrize("colors", [*Colors])
def test_signs_of_the_bar_differ_in_shape_and_are_seen_on_track_and_thumb(
    name: str, colors: Colors
) -> None:
    shapes = [
        *SHADES,
        BAR_RAISED,
        BAR_MARKED,
        BAR_EVENT,
    ]
    assert len(set(shapes)) == len(shapes)
    assert not set(shapes) & {
        *(look.mark for look in LOOKS.values()),
        RAISED_MARK,
        EVENT_SIGN,
        *Sign,
    }
    palette = palette_of(ALL_THEMES[name], colors)
    track, thumb = Style.parse("on #333333"), Style.parse("reverse #888888")
    sign = BarSign(SHADES[0], Style(color=palette.statuses[Status.MALFORMED].color))
    assert sign.over(track).color == sign.style.color
    assert sign.over(track).bgcolor == track.bgcolor
    # A terminal shows the reversed style of the thumb with both colours exchanged.
    assert sign.over(thumb).bgcolor == sign.style.color
    assert sign.over(thumb).color == thumb.color
    assert sign.over(thumb).reverse
