"""The screen; the only package that imports Textual.

Modules:

    actions       Actions on the view and on rows: pause, times, columns, panes, copy and save.
    app           The application: composes the screen, polls the feed, handles signals.
    find_actions  Actions that find rows: go to, marks and notes, filter, search.
    focus         Owner of the focus: which widget receives the keys, which keys may act.
    i18n          Translation, and the names of the themes.
    keys          Key bindings: the source of the keys, the key line and the help.
    modals        Modal screens: pick an entry, choose columns, the help page.
    options       Options with which the screen is opened.
    panes         The panes below the table.
    prompt        Prompt fields at the bottom: filter, search and save.
    status_bar    Lines around the table: title, status, keys and notices.
    table         The table of rows.
    terminal      Terminal driver: output that never blocks, job control.
    text          The values of rows in short words, fitted to a width.
    view_model    Rows polled from a feed, and their counts.
"""
