"""The screen. The only package that imports Textual.

Modules:

    actions         Navigation, filter, search and mark actions.
    app             SniffApp: compose, keys, shutdown.
    export_actions  Save and copy.
    goto            Go to row, time, offset.
    help            Help page.
    i18n            Language choice and translated names.
    keys            Key bindings.
    notices         Notice line.
    options         How the screen is opened.
    panes           The panes beside the table.
    pickers         File, port and column pickers.
    prompt          Input line: filter, search, save, history, completion.
    status_bar      Title, status and key lines.
    table           The table of rows.
    terminal        Terminal ownership and asynchronous output.
    text            Numbers, times and text fitted to a width.
    view_model      Polls a session and holds what the panes show.
"""
