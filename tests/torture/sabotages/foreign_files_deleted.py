# Appended to recording/recorder.py: the oldest file is deleted by its name, whosever it is.
KnownFile.delete = lambda self: self.path.unlink(missing_ok=True)
