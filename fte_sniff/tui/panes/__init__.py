"""The panes beside the table.

Modules:

    bytes       Bytes pane.
    detail      Detail pane.
    motors      Motor cards.
    pane        Pane base class.
    plot        Curves in braille characters.
    statistics  Statistics pane.
    switcher    Which panes are visible.
"""
