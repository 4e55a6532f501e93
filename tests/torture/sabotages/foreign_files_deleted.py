# Appended to recording/recorder.py: the oldest file is deleted by its name, whosever it is.
def _delete_by_name(self, keep=0):
    if len(self._closed) <= keep:
        return False
    self._closed.pop(0).path.unlink(missing_ok=True)
    return True


Recorder._delete_oldest = _delete_by_name
