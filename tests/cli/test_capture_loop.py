"""The loop of a capture: the order in which observers are called, also where one of them fails."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from tempfile import mkdtemp

import pytest

from fte_sniff.analysis.feed import FeedUpdate
from fte_sniff.capture.port_source import PortGroup
from fte_sniff.cli.capture_loop import Observer, capture
from fte_sniff.errors import FileError, PortError
from fte_sniff.platform import ENDING_SIGNALS
from fte_sniff.session.capture_process import CapturePlan
from fte_sniff.session.live_session import LiveSession


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """After a requested end, signals stay ignored and alarms go on until the program exits."""
    numbers = (*ENDING_SIGNALS, signal.SIGALRM)
    before = [signal.getsignal(number) for number in numbers]
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


SIM = "sim://?seed=1&rate=1000"


class Noted(Observer):
    """Notes what it is called for; fails at the first update if there is a failure."""

    def __init__(self, name: str, calls: list[str], failure: Exception | None = None) -> None:
        self._name, self._calls, self._failure = name, calls, failure
        self.rows = 0
        self.updates = 0

    def _note(self, what: str) -> None:
        self._calls.append(f"{self._name} {what}")

    def begun(self, session: LiveSession) -> None:
        self._note("begun" if session.state.started else "begun too early")

    def update(self, update: FeedUpdate, session: LiveSession) -> None:
        if not self.updates:
            self._note("update")
        self.updates += 1
        self.rows += len(update.rows)
        if self._failure is not None:
            raise self._failure

    def ended(self, session: LiveSession) -> None:
        handled = signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
        over = session.state.is_ended
        self._note("ended" if handled and over else "ended outside of the loop")


def recording() -> Path:
    return Path(mkdtemp()) / "x.mcap"


def plan(port: str = SIM, count: int | None = 50) -> CapturePlan:
    return CapturePlan(PortGroup((port,)), recording(), count=count)


ORDER = [
    *("first begun", "last begun"),
    *("first update", "last update"),
    *("last ended", "first ended"),
]


def test_first_observer_is_the_first_to_begin_and_the_last_to_end() -> None:
    calls: list[str] = []
    observers = [Noted("first", calls), Noted("last", calls)]
    assert capture(plan(), observers, ENDING_SIGNALS) == 0
    assert calls == ORDER
    assert [one.rows for one in observers] == [50, 50]


def test_driver_polls_in_place_of_the_loop_and_the_rest_reaches_the_observers() -> None:
    calls: list[str] = []
    observers = [Noted("first", calls), Noted("last", calls)]

    def drive(session: LiveSession) -> int:
        session.wait(0.5)
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
        return 7

    assert capture(plan(), observers, ENDING_SIGNALS, drive) == 7
    assert calls == ORDER
    assert observers[0].rows == observers[1].rows > 0


@pytest.mark.parametrize("failure", [BrokenPipeError(), OSError("full"), FileError("full")])
def test_observer_that_failed_is_called_again_only_at_the_end(failure: Exception) -> None:
    calls: list[str] = []
    first, last = Noted("first", calls), Noted("last", calls, failure)
    if isinstance(failure, BrokenPipeError):
        assert capture(plan(count=None), [first, last], ENDING_SIGNALS) == 0
    else:
        with pytest.raises(type(failure), match="full"):
            capture(plan(count=None), [first, last], ENDING_SIGNALS)
    assert calls == ORDER
    assert first.updates > last.updates == 1


def test_error_of_the_capture_is_raised_after_everything_else() -> None:
    calls: list[str] = []
    observers = [Noted("first", calls), Noted("last", calls)]
    unplugged = CapturePlan(PortGroup((f"{SIM}&frames=20",), reconnect=False), recording())
    with pytest.raises(PortError):
        capture(unplugged, observers, ENDING_SIGNALS)
    assert calls == ORDER


def test_capture_that_could_not_begin_has_no_end(tmp_path: Path) -> None:
    calls: list[str] = []
    with pytest.raises(PortError):
        capture(plan(str(tmp_path / "gone")), [Noted("one", calls)], ENDING_SIGNALS)
    assert calls == []
