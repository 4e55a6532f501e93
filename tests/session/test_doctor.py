from __future__ import annotations

from contextlib import closing

import pytest

from fte_sniff.analysis.line_condition import LineCondition, LineDiagnosis
from fte_sniff.capture.serial_port import PortSettings, open_port
from fte_sniff.errors import PortError
from fte_sniff.protocol.spec import Direction
from fte_sniff.session.doctor import probe_finding, read_for, verdict_finding
from tests.beside import Work


@pytest.mark.parametrize("condition", LineCondition)
def test_every_condition_has_words_and_a_fix(condition: LineCondition) -> None:
    verdict = LineDiagnosis(condition, 100, 0.5, frozenset({Direction.CONTROL}))
    finding = verdict_finding("/dev/p", 115_200, verdict)
    assert finding.what
    assert (finding.fix is None) is (condition is LineCondition.SOUND)


def test_a_probe_names_the_baud_with_most_bytes_in_frames() -> None:
    found = {
        57_600: LineDiagnosis(LineCondition.DAMAGED, 400, 0.3),
        38_400: LineDiagnosis(LineCondition.DAMAGED, 400, 0.6),
    }
    assert probe_finding("/dev/p", found).fix == "fte-sniff live /dev/p --baud 38400"
    assert "no common baud gives frames" in probe_finding("/dev/p", {}).what


FOR_EVER_S = 60.0
SETTINGS = PortSettings()


def test_what_comes_is_heard_until_it_is_enough_and_nothing_is_written(pty):
    with closing(open_port(pty.device)) as port:
        pty.send(b"x" * 500)
        assert read_for(pty.device, port, FOR_EVER_S, 500) == b"x" * 500
        assert read_for(pty.device, port, 0.05, 1) == b""
    assert pty.arrived() == b""


def test_a_port_that_goes_while_it_is_heard_is_one_line(pty):
    with closing(open_port(pty.device)) as port:
        Work(pty.unplug)
        with pytest.raises(PortError, match=r"was lost: .*; check cable and power"):
            read_for(pty.device, port, FOR_EVER_S, 1)
