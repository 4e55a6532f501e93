"""The screen in Chinese: translated texts, in cells that hold them; contract names stay."""

from __future__ import annotations

import ast
import errno
import os
import pickle
import random
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from textwrap import wrap as wrapped_ascii
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from serial import SerialException
from textual.pilot import Pilot
from textual.widgets import Static

from fte_sniff import errors
from fte_sniff.analysis.feed import FeedState
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.capture.port_errors import one_line, port_error
from fte_sniff.capture.serial_port import ControlLine, PortSettings
from fte_sniff.errors import (
    FilterError,
    FteSniffError,
    Joint,
    TranslatableText,
    UsageError,
    listed,
    reason_of,
    unreadable,
    unwritable,
)
from fte_sniff.formats.cell_text import wrap
from fte_sniff.protocol import Chunk, Framer, Gap, LineErrorCounts, PortEvent, PortEventKind, Row
from fte_sniff.protocol.dissect import dissect, explain
from fte_sniff.recording.output_file import DeletedError, stopped_by_error, stopped_by_limit
from fte_sniff.recording.reader import Recording
from fte_sniff.session.inputs import ANOTHER, DAMAGED
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.cells import event_text, landmark_text
from fte_sniff.tui.commands import COMMANDS, KEY_NAMES, SECTIONS, Mode, action_of, short_text
from fte_sniff.tui.i18n import CATALOGUES, _, error_text, language_of, set_language
from fte_sniff.tui.modals import help_text
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.painter import DARK
from fte_sniff.tui.panes import motors
from fte_sniff.tui.panes.row import DetailLayout, detail_text
from fte_sniff.tui.status_bar import (
    RecordingSign,
    StatusCounters,
    badge_text,
    status_text,
    title_text,
)
from tests.analysis.filter.test_parser import MISTAKES
from tests.slow import first
from tests.support.columns import fed
from tests.tui.conftest import NOON_NS, Rows, Scenario, enter_line, lines, page, play, press, settle

CHINESE = StartOptions(language="zh")


def ascii_id(text: str) -> str:
    return text.encode("ascii", "backslashreplace").decode()[:40]


CHARACTER = re.compile("[\u4e00-\u9fff]")


@pytest.fixture(autouse=True)
def alone() -> Iterator[None]:
    """What is spoken here is not spoken in other tests."""
    yield
    set_language("en")


def play_chinese(feed: Any, scenario: Scenario, size: tuple[int, int] = (80, 24)) -> None:
    play(feed, scenario, size, options=CHINESE)


def squeezed(app: SniffApp) -> str:
    """What stands on the screen, without spaces: in pictures, footers have none."""
    return page(app).replace(" ", "")


@pytest.mark.parametrize(
    ("wanted", "environment", "spoken"),
    [
        (None, {}, "en"),
        (None, {"LANG": "zh_CN.UTF-8"}, "zh"),
        ("auto", {"LANG": "zh_TW"}, "zh"),
        (None, {"LANG": "de_DE.UTF-8"}, "en"),
        (None, {"LC_ALL": "C", "LANG": "zh_CN.UTF-8"}, "en"),
        (None, {"LC_ALL": "", "LC_MESSAGES": "zh_CN", "LANG": "en_US"}, "zh"),
        ("en", {"LANG": "zh_CN.UTF-8"}, "en"),
        ("zh", {"LANG": "C"}, "zh"),
    ],
)
def test_what_is_wanted_comes_before_the_locale(
    wanted: str | None, environment: Mapping[str, str], spoken: str
) -> None:
    assert language_of(wanted, environment) == spoken


def test_a_language_that_is_not_spoken_is_one_line() -> None:
    with pytest.raises(UsageError, match="has no language 'tlh'; choose one of en, zh"):
        language_of("tlh", {})


def test_empty_text_stays_empty_in_any_language() -> None:
    set_language("zh")
    assert _("") == ""


def test_title_status_and_footer(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(300))
        await settle(app, pilot)
        text = squeezed(app)
        for words in ("实时", "300行", "帧/秒", "第300行", "?帮助", "q退出", "f过滤", "G跟随"):
            assert words in text
        assert "kind" in text
        await press(app, pilot, "space")
        assert "已暂停，新增0" in squeezed(app)
        await press(app, pilot, "ctrl+t")
        assert "配色textual-light" in squeezed(app)

    play_chinese(feed, scenario)


def test_help_has_every_key_in_chinese_and_every_name_as_it_is(feed: Any) -> None:
    set_language("zh")
    text = help_text(76, DARK).plain
    for _heading, keys in SECTIONS:
        for key in keys:
            assert key.tooltip not in text
    for name in ("vx_cm_s", "reserved_nonzero", "motor = 1 AND rpm > 500", "suspect"):
        assert name in text
    assert max(map(cell_len, text.splitlines())) <= 76

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "question_mark")
        assert "按键与符号" in page(app)
        drawn = app.screen.query_one("#help Static", Static)
        wanted = help_text(drawn.size.width, DARK).plain.split("\n")
        found = [drawn.render_line(y).text.rstrip() for y in range(drawn.size.height)]
        assert found == [line.rstrip() for line in wanted]

    play_chinese(feed, scenario)


@pytest.mark.parametrize("mode", Mode)
def test_the_key_line_is_in_chinese_in_every_mode(mode: Mode) -> None:
    set_language("en")
    english = {one.run: short_text(one, mode) for one in COMMANDS.values()}
    set_language("zh")
    same = [
        one for one in COMMANDS.values() if one.show and short_text(one, mode) == english[one.run]
    ]
    assert same == []


def test_mistakes_examples_and_keys_are_chinese_and_names_stay(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "question_mark")
        assert "↓、pgdn、end" in squeezed(app)
        await press(app, pilot, "escape", "number_sign")
        assert "用手按住了轮子" in squeezed(app)
        await press(app, pilot, "escape")
        await enter_line(app, pilot, "slash", "hex:AA 0g")
        await settle(app, pilot)
        assert "'aa0g'不是十六进制：每个字节写两位" in squeezed(app)
        await press(app, pilot, "escape")
        await enter_line(app, pilot, "f", "moter")
        text = squeezed(app)
        assert "第1个字符处：没有名称'moter'" in text
        assert "您是想写motor吗？" in text
        assert "过滤moter" in text
        assert "回车应用" in text

    play(feed, scenario, options=CHINESE, rows=10)


@pytest.mark.parametrize("text", [text for text, _fragments in MISTAKES], ids=ascii_id)
def test_every_mistake_in_a_filter_is_shown_in_chinese(text: str) -> None:
    set_language("zh")
    with pytest.raises(FilterError) as caught:
        RowFilter.parse(text)
    reported = error_text(caught.value)
    assert CHARACTER.search(reported)
    assert not re.search(r"\b(the|write|is|are|compare|wants)\b", reported.replace(text, ""))
    assert str(caught.value).isascii() or not text.isascii()


def test_port_events_and_the_end_of_a_feed_are_shown_in_chinese(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        lost = TranslatableText("{error}; waiting for it to come back", error="EIO")
        feed.emit(PortEvent(0, "p", PortEventKind.LOST, lost))
        await settle(app, pilot)
        assert "EIO；等待其恢复" in squeezed(app)
        detail = str(LineErrorCounts(framing=2, breaks=1))
        feed.emit(PortEvent(0, "p", PortEventKind.LINE_ERROR, detail, 3))
        await settle(app, pilot)
        assert "UART帧格式错误2，break（线路间断）1" in squeezed(app)
        await press(app, pilot, "escape", "escape")
        feed.end(TranslatableText("{port} was lost: {why}", port="ttyUSB0", why="EIO"))
        await settle(app, pilot)
        assert "ttyUSB0断开：EIO" in squeezed(app)

    play_chinese(feed, scenario)


@pytest.mark.parametrize(
    "error",
    [
        port_error("/dev/nowhere", "/dev/nowhere", OSError(errno.ENOENT, "no such file")),
        port_error("p", "/dev/full", OSError(errno.EBUSY, "busy")),
        port_error("p", "/dev/full", OSError(errno.EACCES, "denied")),
        port_error("p", "/dev/full", OSError(errno.EIO, "broken")),
        port_error("socket://h:1", None, OSError(errno.ECONNREFUSED, "refused")),
        stopped_by_error("a.mcap", OSError(errno.ENOSPC, "full"), 7),
        stopped_by_error("a.mcap", DeletedError(), 7),
        *(
            stopped_by_limit(
                "a.mcap",
                TranslatableText("its files have reached {size} (--max-size)", size="1 GB"),
                7,
                deletes_oldest=deletes_oldest,
            )
            for deletes_oldest in (False, True)
        ),
        unwritable("a.mcap", OSError(errno.ENOSPC, "full")),
        unreadable("a.mcap", FileNotFoundError()),
    ],
)
def test_errors_of_ports_and_files_are_chinese_and_travel_whole(error: FteSniffError) -> None:
    english = str(error)
    set_language("zh")
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == english
    reported = error_text(again)
    assert CHARACTER.search(reported)
    assert not re.search(r"\b(the|is|no|cannot|be|make)\b", reported)


@pytest.mark.parametrize(
    "number",
    [
        *(errno.EPERM, errno.ENOENT, errno.EIO, errno.ENXIO, errno.EACCES, errno.EBUSY),
        *(errno.ENODEV, errno.EINVAL, errno.EMFILE, errno.EFBIG, errno.EROFS),
        *(errno.ENAMETOOLONG, errno.ECONNREFUSED, errno.ECONNRESET, errno.ETIMEDOUT),
    ],
)
def test_reasons_of_the_system_are_unchanged_in_english_and_shown_in_chinese(number: int) -> None:
    error = OSError(number, os.strerror(number))
    assert reason_of(error) == error.strerror
    assert one_line(error) == error.strerror
    set_language("zh")
    for reported in (_(reason_of(error)), _(one_line(error))):
        assert CHARACTER.search(reported)
        assert not re.search("[A-Za-z]", reported)


GONE = (
    "device reports readiness to read but returned no data"
    " (device disconnected or multiple access on port?)"
)


@pytest.mark.parametrize(
    ("error", "chinese"),
    [
        (
            SerialException(GONE),
            "设备显示可读却没有返回数据（设备已断开，或有别的程序同时在读该串口？）",
        ),
        (SerialException(f"read failed: {GONE}"), "设备显示可读"),
        (SerialException("write failed: [Errno 5] Input/output error"), "输入/输出错误"),
        (SerialException("Could not configure port: (5, 'Input/output error')"), "输入/输出错误"),
        (
            FileNotFoundError(errno.ENOENT, "No such file or directory", "/dev/x"),
            "没有那个文件或目录",
        ),
        (PermissionError(errno.EACCES, "Permission denied", "/dev/x"), "权限不够"),
        (OSError(errno.EBUSY, "Device or resource busy"), "设备或资源忙"),
        (SerialException("device reports error (poll)"), "设备报告错误"),
        (SerialException("socket disconnected"), "套接字已断开"),
    ],
)
def test_events_of_a_port_are_shown_in_chinese(error: OSError, chinese: str) -> None:
    reported = one_line(error)
    assert reported in str(error)
    set_language("zh")
    assert chinese in event_text(PortEvent(0, "p", PortEventKind.LOST, reported))


AMBIGUOUS = bytes.fromhex("AA 02 03 EE 55 02 01 03 E8 EE")
"""A position frame that can also be two truncated frames."""


def test_the_detail_names_both_readings_with_their_probabilities(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        framer = Framer("p")
        feed.give(fed(framer, Chunk("p", NOON_NS, AMBIGUOUS)) + list(framer.finish()))
        await settle(app, pilot)
        await press(app, pilot, "i")
        for size in ((80, 24), (200, 60)):
            await pilot.resize_terminal(*size)
            await settle(app, pilot)
            for share, reading in (
                ("90.90 %", "position AA 02 03 EE 55 02 01 03 E8 EE"),
                ("9.09 %", "truncated AA 02 03 EE + truncated 55 02 01 03 E8 EE"),
            ):
                assert f"probability {share}: {reading}" in page(app)
        await app.run_action(action_of("app.language"))
        assert "概率 90.90 %：position AA 02" in page(app)

    play(feed, scenario)


@pytest.mark.parametrize(
    ("language", "line"),
    [
        ("en", "LR: + is left by the document's rule; its example calls +10 right (erratum 3)"),
        ("zh", "LR：按文档规则正值为左，但文档示例把 +10 写作右移（勘误 3）"),
    ],
)
def test_the_detail_of_a_move_to_the_side_names_the_erratum(language: str, line: str) -> None:
    set_language(language)
    for speed, shown in (("00 00", 0), ("00 0A", 1), ("FF F6", 1)):
        row = Row("p", 0, bytes.fromhex(f"AA 03 00 00 14 {speed} 00 00 EE"), None, ())
        assert detail_text(row, DARK, DetailLayout(120, bit_lines=False)).plain.count(line) == shown


def test_words_that_nobody_knows_stay_as_they_are() -> None:
    for words in ("[Errno 5] something else", "[Errno 999] Odd", "write failed: odd", "(5, 'odd')"):
        assert one_line(SerialException(words)) == words
        set_language("zh")
        assert _(one_line(SerialException(words))) == words


def test_texts_of_a_file_are_chinese_where_their_parts_are_known() -> None:
    set_language("zh")
    settings = PortSettings(rts=ControlLine.ON)
    detail = f"{settings}; no low latency setting; line errors unavailable; odd"
    opened = event_text(PortEvent(0, "p", PortEventKind.OPENED, detail))
    shown = "115200 波特 8N1，DTR 关闭，RTS 打开"
    assert opened.endswith(f"p 已打开：{shown}；没有低延迟设置；无法得知线路错误；odd")
    assert _(str(settings)) == shown
    for kind, reason in (DAMAGED, ANOTHER):
        text = landmark_text(Gap(kind, reason=str(reason)))
        assert not re.search("[a-z]", text), text


def test_gaps_of_a_damaged_recording_are_shown_in_chinese(tmp_path: Path, samples: Path) -> None:
    """Whatever bytes are altered: but for names, no English word is left."""
    content = (samples / "clean.mcap").read_bytes()
    path, chance = tmp_path / "x.mcap", random.Random(1)
    altered = [content[:-100], content[:5000], bytes(60) + content[60:], content + b"more"]
    for _at in range(60):
        junk = bytearray(content)
        place = chance.randrange(8, len(junk) - 60)
        junk[place : place + chance.choice([1, 40])] = chance.randbytes(chance.choice([1, 40]))
        altered.append(bytes(junk))
    set_language("zh")
    reported = set[str]()
    for damaged in altered:
        path.write_bytes(damaged)
        try:
            reader = Recording(path)
            for _columns in reader.batches():
                pass
        except FteSniffError as error:
            reported.add(error_text(error))
        else:
            reported.update(_(loss) for loss in (*reader.losses, reader.ending) if loss)
    assert len(reported) > 10
    for loss in reported:
        assert CHARACTER.search(loss), loss
        plain = loss.replace(str(path), "").replace("fte-sniff repair", "")
        assert not re.search(r"\b(a|the|is|of|at|bytes?|chunk|record|not|it)\b", plain), loss


@pytest.mark.parametrize("size", first(2, [((80, 24),), ((40, 10),), ((200, 60),)]))
def test_nothing_is_wider_than_the_screen(
    feed: Any, odd_rows: list[Any], speed_rows: Rows, size: tuple[int, int]
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([*speed_rows(50), *odd_rows])
        before = []
        for key in ("", "i", "b", "M", "S", "C", "ctrl+p", "f", "w", "colon", "x"):
            await press(app, pilot, *filter(None, [key]))
            for _tick in range(2):
                await settle(app, pilot)
            drawn = lines(app)
            assert drawn != before, f"{key} opens nothing"
            assert max(cell_len(line.rstrip()) for line in drawn) <= size[0], key
            assert not re.search(r"\{[a-z0-9_]+[:}]", "\n".join(drawn)), key
            await press(app, pilot, "escape")
            before = lines(app)

    play_chinese(feed, scenario, size)


def test_explanations_of_frames_and_damage_are_chinese(odd_rows: list[Any]) -> None:
    set_language("zh")
    for row in odd_rows:
        for text in (*explain(row), *(part.meaning for part in dissect(row)), *_notes(row)):
            assert text.startswith(("CMD", "NUM")) or not text or CHARACTER.search(_(text)), text
            assert not re.search(r" (or|and) |, ", _(text))


def _notes(row: Any) -> list[str]:
    return [part.note for part in dissect(row)]


@given(st.lists(st.text().map("no message: {}".format), max_size=5), st.sampled_from(Joint))
def test_lists_are_joined_in_the_language_of_the_screen(items: list[str], joint: Joint) -> None:
    english, chinese = joint.format(before="", after=""), {", ": "、", " or ": " 或 "}
    set_language("en")
    assert _(listed(items, joint)) == english.join(items)
    set_language("zh")
    assert _(listed(items, joint)) == chinese.get(english, " 和 ").join(items)
    set_language("en")


def _texts_with_joined_words(path: Path) -> Iterator[str]:
    """Translatable texts with a value that joins a list with English words or commas."""
    for function in ast.walk(ast.parse(path.read_text("utf-8"))):
        if not isinstance(function, ast.FunctionDef):
            continue
        nodes = [*ast.walk(function)]
        values = {
            ast.unparse(target): node.value
            for node in nodes
            if isinstance(node, ast.Assign)
            for target in node.targets
        }
        for node in nodes:
            if not isinstance(node, ast.Call) or not node.keywords:
                continue
            called = ast.unparse(node.func)
            if re.search(r"(^TranslatableText|Error|^_\(.*\.format)$", called):
                for keyword in node.keywords:
                    value = ast.unparse(values.get(ast.unparse(keyword.value), keyword.value))
                    if re.search(r"""'(, | or | and )'\.join""", value):
                        yield f"{path.name}:{node.lineno}: {value}"


def test_no_translated_text_has_an_english_list_in_it() -> None:
    package = Path(errors.__file__).parent
    found = [text for path in package.rglob("*.py") for text in _texts_with_joined_words(path)]
    assert found == []


_CATALOGUE = CATALOGUES / "zh" / "LC_MESSAGES" / "fte-sniff.po"
RETIRED_WORDS = {
    **dict.fromkeys(KEY_NAMES, r"(?<![a-z_]){}(?![a-z_])"),
    **{"PgDn": "{}", "PgUp": "{}", "重新找到": "{}", "串口丢失": "{}"},
}
"""Names of keys that have a Chinese one, and other words for what has one; each with its form."""


def test_keys_and_a_lost_port_have_one_name_each_in_chinese() -> None:
    texts = re.findall(r'^msgstr "(.*)"$', _CATALOGUE.read_text("utf-8"), re.MULTILINE)
    assert len(texts) > 500
    for word, form in RETIRED_WORDS.items():
        pattern = re.compile(form.format(re.escape(word)))
        assert [text for text in texts if pattern.search(re.sub("{.*?}", "", text))] == []


def test_the_numbers_of_a_motor_are_behind_their_names_in_chinese() -> None:
    set_language("zh")
    for form in (motors.WINDOW[0], *motors.COMMANDS, "{rate} commands, no answer for {span}"):
        assert _(form).startswith("命令 {rate}")
    for form in ("{rate} feedback", *motors.FEEDBACK):
        assert _(form).startswith("反馈 {rate}")


def test_padding_begins_its_text_in_chinese() -> None:
    texts = re.findall(r'^msgstr "(.*)"$', _CATALOGUE.read_text("utf-8"), re.MULTILINE)
    padded = [text for text in texts if ":>" in text]
    assert padded
    assert all(text.startswith("{") for text in padded)


def test_a_text_from_outside_is_never_translated() -> None:
    set_language("zh")
    assert _(TranslatableText("unknown name '{term}'", term="stopped")) == "没有名称 'stopped'"


@given(st.text(), st.integers())
def test_a_sentence_travels_whole(text: str, number: int) -> None:
    inner = TranslatableText("{count:,} framing", count=number)
    said = TranslatableText("{one}, {other}", one=text, other=inner)
    again = pickle.loads(pickle.dumps(said))
    assert (again, again.form, again.values) == (said, said.form, said.values)
    assert again == f"{text}, {number:,} framing"


def test_a_sentence_keeps_its_values() -> None:
    text = TranslatableText("expected {wanted}, found {found}", wanted="1..4", found=9)
    assert text == "expected 1..4, found 9"
    assert _(text) == text
    set_language("zh")
    assert _(text) == "应为 1..4，实为 9"


@given(
    st.text(alphabet=st.sampled_from("ab c，。（）帧头错误-"), max_size=60),
    st.integers(min_value=4, max_value=30),
)
def test_wrapped_text_fits_and_loses_nothing_but_spaces(text: str, width: int) -> None:
    wrapped = wrap(text, width)
    assert all(cell_len(line) <= width for line in wrapped)
    assert "".join(wrapped).replace(" ", "") == text.replace(" ", "")


@given(st.text(alphabet="ab -", max_size=60), st.integers(min_value=1, max_value=30))
def test_ascii_is_wrapped_between_words(text: str, width: int) -> None:
    assert wrap(text, width) == wrapped_ascii(text, width, break_on_hyphens=False)


@pytest.mark.parametrize("mode", Mode)
def test_the_title_has_its_width_and_ends_with_the_state(mode: Mode) -> None:
    set_language("zh")
    state = FeedState("/dev/ttyUSB0", "/tmp/记录/a-long-name-of-a-recording.mcap", progress=0.5)
    for width in (30, 80, 120):
        title = title_text(state, mode, 1_234, width)
        assert cell_len(title) == width
        assert title.endswith(badge_text(state, mode, 1_234))


def test_the_line_of_numbers_has_its_width_in_any_language() -> None:
    set_language("zh")
    numbers = StatusCounters(12_345, 800.0, 7, 0.01, 5, 12, False, 99, 3)
    for width in range(30, 121):
        assert cell_len(status_text(numbers, width)) == width


def test_modes_have_words_of_their_own() -> None:
    set_language("zh")
    said: Callable[[str], str] = _
    assert len({said(mode) for mode in Mode}) == len(Mode)


@pytest.mark.parametrize(
    ("language", "page"), [("en", "docs/screen.md"), ("zh", "docs/zh/screen.md")]
)
def test_the_documentation_has_every_mode_and_state_of_the_recording(
    language: str, page: str
) -> None:
    text = (Path(__file__).parents[2] / page).read_text("utf-8")
    set_language(language)
    missing = [mode for mode in Mode if f"| {_(mode)}" not in text]
    assert not missing
    assert not [sign for sign in RecordingSign if f"| `{sign} " not in text]


@pytest.mark.parametrize(
    ("form", "values", "shown"),
    [
        ("{count:>5,} rows", {"count": 1}, "    1 row"),
        ("{count:,} rows", {"count": 1001}, "1,001 rows"),
        ("{rows:,} rows, {bytes:,} bytes", {"rows": 1, "bytes": 10}, "1 row, 10 bytes"),
        ("{shown:,} of {all:,} rows", {"shown": 1, "all": 2}, "1 of 2 rows"),
        ("{count:,} rows are missing here", {"count": 1}, "1 rows are missing here"),
        ("took {ms} ms", {"ms": 1}, "took 1 ms"),
    ],
)
def test_one_of_something_is_not_a_plural(form: str, values: dict[str, int], shown: str) -> None:
    assert _(form, **values) == shown
