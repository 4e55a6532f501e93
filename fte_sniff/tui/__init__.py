"""The screen; the only package that imports Textual.

Modules:

    app           The application: composes the screen, polls the feed, handles signals.
    cells         Values of rows as text: in short words, and in the columns of the table.
    commands      The commands: their keys, the key line, the help and the palette.
    controllers   What the commands do: rows, search, filters, notes, export, playback, view.
    focus         Owner of the focus: which widget receives the keys, which keys may act.
    i18n          Translation, and the names of the themes.
    modals        Modal screens: pick an entry, choose columns, the help page.
    options       Options with which the screen is opened.
    painter       What the table draws: colours, lines, signs in the scroll bar.
    panes         The panes below the table.
    prompt        Prompt fields at the bottom: filter, search and save.
    status_bar    Lines around the table: title, status, keys and notices.
    table         The table of rows.
    terminal      Terminal driver: output that never blocks, one frame at a time, job control.
    view_model    Rows polled from a feed, and their counts.
"""
