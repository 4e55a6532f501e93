# Appended to recording/writer.py: one row in 10,000 is not recorded.
_write, _count = RecordingWriter.write, 0


def _write_most(self, entries):
    global _count
    kept = []
    for entry in entries:
        _count += 1
        if _count % 10_000:
            kept.append(entry)
    _write(self, kept)


RecordingWriter.write = _write_most
