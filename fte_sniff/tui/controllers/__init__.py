"""What the commands of the screen do, by the state that they change.

Each controller gets the parts of the screen, not the app, and has an `action_...` method for each
of its commands.

Modules:

    controller  Base class, and the parts of the screen that they change.
    export      Copy rows to the clipboard; save rows and pictures of the screen.
    filters     Filter the rows; earlier and saved filters.
    findings    Search for findings while rows come, list them, and go to their rows.
    notes       Marks and notes on rows.
    playback    Freeze the view of a capture; play a file.
    rows        Go to rows, and select them.
    search      Search the rows for a text or bytes.
    view        What the table shows, and which pane is open.
"""
