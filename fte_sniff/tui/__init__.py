"""The screen; the only package that imports Textual.

Modules:

    app           The application: composes the screen, polls the feed, handles signals.
    cells         Values of rows as text: in short words, and in the columns of the table.
    commands      The commands: their keys, the key line, the help and the palette.
    export        Copy rows; save rows and pictures of the screen.
    filters       The field for a filter, its candidates, and the filters before.
    find          The fields that lead to a row: go to, and search.
    i18n          Translation, and the names of the themes.
    modals        Modal screens: pick an entry, choose columns, the help page.
    notes         Marks and notes on rows.
    options       Options with which the screen is opened.
    painter       What the table draws: colours, lines, signs in the scroll bar.
    panes         The panes below the table.
    playback      Freeze the view of a capture; play a file.
    prompt        Base class of the fields at the bottom, and the focus.
    status_bar    Lines around the table: title, status, keys and notices.
    table         The table of rows.
    terminal      Terminal driver: output that never blocks, one frame at a time, job control.
    view_model    Rows polled from a feed, and their counts.
"""
