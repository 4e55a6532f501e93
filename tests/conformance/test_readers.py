"""The rows that went into a recording come out of every reader that people have, as they were."""

import pytest

from tests.conformance.conftest import Recorded
from tests.conformance.expected import digest, expected_lines

pytestmark = pytest.mark.conformance


@pytest.mark.parametrize("reader", ["python", "typescript", "rust", "rerun"])
def test_every_reader_finds_the_rows_that_went_in(
    reader: str, recorded: Recorded, request: pytest.FixtureRequest
) -> None:
    path, rows, events = recorded
    read = request.getfixturevalue(reader)(path)
    wanted = expected_lines(rows, events)
    assert read[:5] == wanted[:5]
    assert digest(read) == digest(wanted)
