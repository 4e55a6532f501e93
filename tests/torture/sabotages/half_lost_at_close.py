# Appended to recording/writer.py: at the end, the first, third, ... batch that waits is forgotten.
_close = RecordingWriter.close


def _close_with_half(self):
    self.unflushed = self.unflushed[1::2]
    _close(self)


RecordingWriter.close = _close_with_half
