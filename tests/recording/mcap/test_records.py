"""The running checksum: however bytes are cut into pieces, that of all of them together."""

from zlib import crc32

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.recording.mcap.records import RunningChecksum


@given(st.lists(st.sampled_from([0, 1, 9, 60_000, 64 * 1024, 70_000]), max_size=30), st.data())
def test_the_running_checksum_is_that_of_all_pieces(sizes: list[int], data: st.DataObject) -> None:
    running, whole = RunningChecksum(), b""
    for number, size in enumerate(sizes):
        piece = bytes([number]) * size
        running.update(piece)
        whole += piece
        if data.draw(st.booleans()):
            assert running.value() == crc32(whole)
    assert running.value() == crc32(whole)
