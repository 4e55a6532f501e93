# Appended to recording/writer.py: one row in 10,000 is not recorded.
_write, _count = RecordingWriter.write, 0


def _write_most(self, rows):
    global _count
    numbers = np.arange(_count, _count + len(rows)) + 1
    _count += len(rows)
    _write(self, rows.select(numbers % 10_000 > 0, rows.events))


RecordingWriter.write = _write_most
