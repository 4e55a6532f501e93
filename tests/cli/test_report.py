"""`report`: the page in a real browser, what it shows of the rows, and what it refuses."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest
from selenium import webdriver
from selenium.webdriver.common.actions.action_builder import ActionBuilder
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.expected_conditions import visibility_of
from selenium.webdriver.support.ui import WebDriverWait

import fte_sniff
from fte_sniff.analysis.plots import Timeline
from fte_sniff.analysis.time_text import time_ns
from fte_sniff.cli.options import install_command
from fte_sniff.protocol import KIND_BY_NAME, Row, encode
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.metadata import PortFacts
from tests.browser import CHROMIUM, DRIVER, WAIT_S, drawn, open_browser
from tests.cli.conftest import plain_environment
from tests.cli.program import Program
from tests.slow import first
from tests.support.recorded_rows import START_NS, write_recording

pytestmark = pytest.mark.browser

MS = 1_000_000
HOSTILE = "<script>window.hit=1</script>\"'><img src=x onerror=window.hit=1>"


needs_browser = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="Chromium and ChromeDriver are not installed"
)


@pytest.fixture(scope="module")
def browser() -> Iterator[webdriver.Chrome]:
    with open_browser() as browser:
        yield browser


@contextmanager
def emulated(
    browser: webdriver.Chrome, width: int, height: int, mobile: bool = False, scheme: str = "light"
) -> Iterator[None]:
    """A screen of this size, in pixels, on a system with light or dark colours."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    colours = {"name": "prefers-color-scheme", "value": scheme}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [colours]})
    try:
        yield
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def feedback(
    number: int, rpm: int, motor: int = 1, *, t_ms: int, port: str = "a", **flags: int
) -> Row:
    raw = encode(KIND_BY_NAME["speed_feedback"], {"motor": motor, "rpm": rpm, **flags})
    return Row(port, 10 * number, raw, START_NS + t_ms * MS, (), delay_ns=0)


def recorded(path: Path, frames: list[Row], facts: dict[str, str] | None = None) -> Path:
    ports = [PortFacts(port) for port in dict.fromkeys(frame.port for frame in frames)]
    write_recording(path, ports or [PortFacts("a")], [Rows.of(frames)], facts)
    return path


Made = Callable[..., Path]


@pytest.fixture(scope="module")
def made(program: Program, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Make the report of these arguments; the tests share it."""
    folder = tmp_path_factory.mktemp("reports")
    environment = plain_environment() | {"FTE_SNIFF_CONFIG": str(folder / "config.toml")}

    @cache
    def made(*arguments: str | Path) -> Path:
        made_page = folder / f"{len(list(folder.iterdir()))}.html"
        words = ["report", *map(str, arguments), "-o", str(made_page)]
        ended = program.run(words, b"", folder, environment)
        assert ended.code == 0, ended.errors
        return made_page

    return made


def source(browser: webdriver.Chrome, name: str) -> dict[str, list]:
    """The data of a plot, which is scrolled into sight."""
    element = scrolled_to(browser, name)
    WebDriverWait(browser, WAIT_S, 0.02).until(visibility_of(element))
    script = """
        const data = Bokeh.documents[0].get_model_by_name(arguments[0]).data;
        return Object.fromEntries(Object.entries(data).map(([k, v]) => [k, Array.from(v)]));
    """
    return browser.execute_script(script, name)


def scrolled_to(browser: webdriver.Chrome, name: str) -> WebElement:
    """The plot of this data, after it was scrolled to."""
    script = """
        const named = (name) => Bokeh.documents[0].get_model_by_name(name);
        const figure = Bokeh.documents[0].roots().find(
            (one) => one.renderers.some((each) => each.data_source === named(arguments[0])));
        const {el} = Bokeh.index.find_one(figure);
        el.scrollIntoView({block: "center"});
        return el;
    """
    found: WebElement = browser.execute_script(script, name)
    return found


def rows_of(run, path: Path, asked: str) -> list[dict]:
    done = run("decode", path, "--format", "jsonl", "--filter", asked)
    return [json.loads(line) for line in done.stdout.splitlines()]


def zoomed(browser: webdriver.Chrome, start_ms: float, end_ms: float) -> None:
    count = int(browser.execute_script("return document.documentElement.dataset.drawn"))
    script = """
        const range = Bokeh.documents[0].get_model_by_name("time");
        range.setv({start: arguments[0], end: arguments[1]});
    """
    browser.execute_script(script, start_ms, end_ms)
    drawn(browser, count + 1)


def shown(browser: webdriver.Chrome, page: Path) -> None:
    browser.get(page.as_uri())
    drawn(browser)
    assert [one for one in browser.get_log("browser") if one["level"] == "SEVERE"] == []


def show_full_range(browser: webdriver.Chrome) -> None:
    count = int(browser.execute_script("return document.documentElement.dataset.drawn"))
    browser.find_element(By.ID, "full").click()
    drawn(browser, count + 1)


def known(values: list[float | None]) -> list[float]:
    """The values without the breaks of a line, which are NaN in the page and None here."""
    return [value for value in values if value is not None]


def y_axis(browser: webdriver.Chrome, plot: str) -> tuple[float, float]:
    script = """
        const {y_range} = Bokeh.documents[0].get_model_by_name(arguments[0]);
        return [y_range.start, y_range.end];
    """
    start, end = browser.execute_script(script, plot)
    return start, end


@needs_browser
def test_a_spike_of_one_row_is_visible_at_every_zoom(tmp_path, made, browser) -> None:
    """As a mark with its value, which flattens nothing, and in the line of the full range."""
    spikes = {1: (3000, "triangle"), 2: (-3000, "inverted_triangle")}
    frames = [
        feedback(2 * number + motor, rpm, motor, t_ms=number)
        for number in range(10_000)
        for motor in spikes
        for rpm in [spikes[motor][0] if number == 6_234 else 100 + number // 100 % 50]
    ]
    shown(browser, made(recorded(tmp_path / "a.mcap", frames)))
    spike_ms = (START_NS + 6_234 * MS) / 1e6
    widths_ms = (20_000, 4_000, 500, 20)
    for width_ms in widths_ms:
        zoomed(browser, spike_ms - width_ms / 3, spike_ms + width_ms)
        for motor, (spike, marker) in spikes.items():
            line = source(browser, f"rpm-{motor}-actual")
            marks = source(browser, f"rpm-{motor}-outliers")
            assert 100 <= min(known(line["y"])) <= max(known(line["y"])) < 150
            assert (marks["value"], marks["marker"]) == ([spike], [marker])
            assert abs(marks["x"][0] - spike_ms) < 0.01
            low, high = y_axis(browser, f"rpm-{motor}")
            assert 90 < low < high < 160
    show_full_range(browser)
    for width_ms in widths_ms:
        zoomed(browser, spike_ms - width_ms / 3, spike_ms + width_ms)
        line = source(browser, "rpm-1-actual")
        assert source(browser, "rpm-1-outliers")["x"] == []
        assert max(line["y"]) == 3000
        assert 100 <= min(line["y"]) < 150
        assert abs(line["x"][line["y"].index(3000)] - spike_ms) < 0.01


@needs_browser
def test_the_plots_have_exactly_the_rows(run, made, browser, samples) -> None:
    """Curves, the histogram of answers, and the bytes of a fault that is clicked."""
    damaged = samples / "damaged.mcap"
    shown(browser, made(damaged))
    show_full_range(browser)
    rows = rows_of(run, damaged, "kind = 'speed_feedback' AND motor = 2")
    found = source(browser, "rpm-2-actual")
    assert known(found["y"]) == [row["rpm"] for row in rows]
    commands = rows_of(run, damaged, "direction = 'control' AND (motor = 2 OR motor IS NULL)")
    assert 0 < len(source(browser, "rpm-2-commands")["x"]) <= len(commands)
    targets = known(source(browser, "rpm-2-target")["y"])
    speeds = [row["rpm"] for row in commands if row["kind"] == "speed"]
    assert targets[: len(speeds)] == speeds
    script = """
        return Bokeh.documents[0].get_model_by_name("delays").renderers
            .map((one) => Array.from(one.data_source.data.top));
    """
    answered = [one["answered"] for one in fte_sniff.stats(damaged)["motors"]]
    assert [sum(counts) for counts in browser.execute_script(script)] == answered
    place = """
        const {frame} = viewOf("faults"), data = named("faults-rows").data;
        return ["faults", frame.x_scale.compute(data.x[0]), frame.y_scale.compute(data.y[0])];
    """
    pointer(browser, at(browser, place), "click")
    cells = [one.text for one in browser.find_elements(By.CSS_SELECTOR, "#rows tbody tr td")]
    assert len(cells) == 5
    rows = rows_of(run, damaged, f"offset = {cells[2].replace(',', '')}")
    assert [(row["raw"], ", ".join(row["faults"])) for row in rows] == [
        (cells[4].replace(" ", ""), cells[3])
    ]
    script = """
        const [axis] = Bokeh.documents[0].get_model_by_name("faults").left;
        return Array.from(axis.major_label_overrides.values());
    """
    found = {fault for row in rows_of(run, damaged, "status <> 'ok'") for fault in row["faults"]}
    assert set(browser.execute_script(script)) == found


@needs_browser
def test_tables_and_plots_are_in_the_zone(run, made, browser, samples) -> None:
    """Labels of an axis are those of UTC, so its places are shifted by the offset."""
    motor3 = samples / "motor3.mcap"
    before = made(motor3).read_text("utf-8")
    page = made(motor3, "--zone", "Asia/Tokyo")
    shown(browser, page)
    times = [
        time_ns(row["time"]) / 1e6 + 9 * 3600 * 1000
        for row in rows_of(run, motor3, "kind = 'speed_feedback' AND motor = 1")
    ]
    drawn_ms = source(browser, "rpm-1-actual")["x"]
    assert (drawn_ms[0], drawn_ms[-1]) == pytest.approx((times[0], times[-1]), rel=0, abs=1)
    after = page.read_text("utf-8")
    assert "Times are UTC." in before
    assert "Times are UTC+09:00." in after
    for text, hour in ((before, 12), (after, 21)):
        assert f"Motor 3, 2026-01-31 {hour}:00:30" in text
        assert f"<td>2026-01-31 {hour}:00:00.029</td>" in text


def command(number: int, rpm: int, motor: int = 1, *, t_ms: int) -> Row:
    raw = encode(KIND_BY_NAME["speed"], {"motor": motor, "rpm": rpm})
    return Row("a", 10 * number, raw, START_NS + t_ms * MS, (), delay_ns=0)


def at(browser: webdriver.Chrome, place: str) -> tuple[int, int]:
    """Scroll to a plot, and return a place of it in the window: `return [x, y]` in its view."""
    script = f"""
        const named = (name) => Bokeh.documents[0].get_model_by_name(name);
        const viewOf = (name) => Bokeh.index.find_one(named(name));
        const inside = (() => {{ {place} }})();
        const view = viewOf(inside[0]);
        view.el.scrollIntoView({{block: "center"}});
        const box = view.el.getBoundingClientRect();
        return [Math.round(box.x + inside[1]), Math.round(box.y + inside[2])];
    """
    x, y = browser.execute_script(script)
    return x, y


def pointer(browser: webdriver.Chrome, *steps: str | tuple[int, int]) -> None:
    """Move the mouse to places, and press, release or click it."""
    actions = ActionBuilder(browser)
    for step in steps:
        if isinstance(step, str):
            getattr(actions.pointer_action, step)()
        else:
            actions.pointer_action.move_to_location(*step)
    actions.perform()


@needs_browser
def test_text_from_files_executes_nothing_and_is_not_cut_off_on_paper(
    tmp_path, made, browser
) -> None:
    name, port = HOSTILE.replace("/", "_"), f"{HOSTILE}?{'long=1&' * 60}"
    frames = [feedback(number, 5, t_ms=number, port=port) for number in range(9)]
    broken = Row(port, 90, bytes.fromhex("55 01 09 00 00 00 00 00 0F EE"), START_NS, (), delay_ns=0)
    path = recorded(tmp_path / f"{name}.mcap", [*frames, broken], {HOSTILE: HOSTILE})
    shown(browser, made(path, "--filter", "port != '<script>window.hit=1</script>'"))
    assert browser.execute_script("return window.hit") is None
    assert HOSTILE in browser.find_element(By.TAG_NAME, "body").text
    assert browser.execute_script("return document.images.length") == 0
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        script = """
            return [...document.querySelectorAll("table")].map((one) => one.scrollWidth
                - one.parentElement.clientWidth)
        """
        assert max(browser.execute_script(script)) <= 0
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_the_cards_of_a_chinese_report_are_chinese(made, samples: Path) -> None:
    page = made(samples / "damaged.mcap", "--lang", "zh").read_text()
    cards = page.partition('<div class="cards">')[2].partition("\n</div>")[0]
    labels = re.findall(r"<span>([^<0-9]+)", cards)
    assert [label.strip() for label in labels] == ["行数", "时长", "正常", "可疑", "损坏"]


@needs_browser
@pytest.mark.parametrize(("language", "scheme"), first(1, [("zh", "dark"), ("en", "light")]))
def test_it_needs_no_network_and_fits_a_phone(made, browser, samples, language, scheme) -> None:
    page = made(samples / "damaged.mcap", "--lang", language)
    with emulated(browser, 400, 900, mobile=True, scheme=scheme):
        shown(browser, page)
        entries = "return performance.getEntriesByType('resource').map(one => one.name)"
        assert [
            name
            for name in browser.execute_script(entries)
            if not name.startswith(("data:", "blob:"))
        ] == []
        assert browser.execute_script("return document.documentElement.scrollWidth") <= 400
        heading = browser.find_elements(By.TAG_NAME, "h2")[0].text
        assert heading == {"en": "Findings", "zh": "诊断结果"}[language]
        ground = browser.execute_script(
            'return Bokeh.documents[0].get_model_by_name("faults").background_fill_color'
        )
        assert ground == {"light": "#ffffff", "dark": "#161a20"}[scheme]


def test_the_numbers_are_those_of_stats(run, made, samples) -> None:
    text = made(samples / "damaged.mcap").read_text("utf-8")
    numbers = json.loads(run("stats", samples / "damaged.mcap", "--format", "json").stdout)
    for fault in numbers["ports"][0]["faults"]:
        assert re.search(rf">{fault['fault']}</td><td class=\"number\">{fault['rows']:,}<", text)
    for stream in numbers["ports"][0]["streams"]:
        assert f"<tr><td>{stream['kind']}</td>" in text
    for motor in numbers["motors"]:
        names = ("motor", "commands", "feedback", "answered", "unanswered", "neither")
        counts = [f'<td class="number">{motor[name]:,}</td>' for name in names]
        assert f"<tr>{''.join(counts)}" in text
        for bit in motor["error_bits"]:
            assert f"Bit {bit['bit']} in {bit['frames']:,} of {motor['feedback']:,} frames" in text
    assert "Neither: resets; commands before the first feedback" in text
    heads = set(re.findall(r"<th[^>]*>([^<]*)</th>", text))
    assert {"Rows", "Bytes", "Fault", "Neither", "99 %"} <= heads
    assert all(head[0].isupper() for head in heads - {"99 %"})


@pytest.mark.parametrize("most_points", [9, 10])
def test_a_page_without_every_row_is_marked(tmp_path, most_points: int) -> None:
    from fte_sniff.cli.report_page import ReportFacts, page

    frames = [feedback(number, 5, t_ms=number) for number in range(10)]
    timeline = Timeline(most_points)
    timeline.observe(Rows.of(frames))
    numbers = fte_sniff.stats(recorded(tmp_path / "a.mcap", frames))
    text = page(timeline, numbers, ReportFacts("a", [], {}, [], {}))
    assert ("the minimum and maximum of bins of time" in text) is (most_points == 9)


def test_rows_without_times_have_no_plots(made, samples) -> None:
    text = made(samples / "damaged.raw").read_text("utf-8")
    assert "The rows have no times" in text
    assert 'id="data"></script>' in text
    assert "truncated" in text


def test_a_file_that_cannot_be_read_is_reported_and_the_others_are_in_the_page(
    run, tmp_path, samples
) -> None:
    (tmp_path / "junk.mcap").write_bytes(b"junk")
    done = run("report", "junk.mcap", samples / "damaged.raw", "-o", "r.html")
    assert done.returncode == 4
    assert "junk.mcap" in done.stderr
    assert "damaged.raw" in (tmp_path / "r.html").read_text("utf-8")


def test_without_bokeh_a_line_names_the_command_that_installs_it(tmp_path, samples) -> None:
    missing = "raise ModuleNotFoundError(\"No module named 'bokeh'\", name='bokeh')"
    (tmp_path / "bokeh.py").write_text(missing)
    code = "import sys; sys.path.insert(0, sys.argv.pop(1)); from fte_sniff.cli import main; main()"
    words = [sys.executable, "-P", "-c", code, str(tmp_path), "report"]
    done = subprocess.run(
        [*words, str(samples / "damaged.raw"), "-o", str(tmp_path / "r.html")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (2, "")
    assert f"`{install_command('report')}`" in done.stderr
    assert done.stderr.count("\n") == 1
