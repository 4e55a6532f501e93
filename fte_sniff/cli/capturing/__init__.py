"""The run of a capture, as `live` and `bridge` share it.

It must not know what is captured.

    running             the options they share, and the run itself
    recording_options   how often a recording is flushed, what of it is kept
    planning            how options become the plan of a capture
    plain               lines instead of a screen
"""
