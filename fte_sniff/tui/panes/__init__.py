"""The panes below the table.

To add one: write a subclass of `Pane` in a module here, list it in `switcher.PANES`, and give it a
key in `commands.UNDERSTANDING`.

Modules:

    findings    The spans of time in which something is wrong.
    motors      State and plots of each motor.
    pane        Base class, and the context that panes draw.
    plot        Curves in braille characters.
    row         A row explained byte by byte, and the bytes of the stream around it.
    statistics  Rates, line use and faults of all rows.
    switcher    The list of panes; shows one at a time, and keeps the models and findings current.
    top         Top view: one sorted line for each kind and motor, in place of the table.
"""
