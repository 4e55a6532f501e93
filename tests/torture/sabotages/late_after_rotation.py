# Appended to recording/writer.py: rows of all files but the first are recorded 1 ms late.
_write = RecordingWriter.write


def _write_late(self, rows):
    if self.path.stem[-5:].isdigit() and not self.path.stem.endswith("00001"):
        rows = rows.replace(t_ns=rows.t_ns + 1_000_000)
    _write(self, rows)


RecordingWriter.write = _write_late
