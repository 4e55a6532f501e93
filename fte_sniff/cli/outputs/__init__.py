"""Where rows and numbers go: standard output, a new file, a page for people.

It must not know where they come from.

    destination     standard output, or a file that must not be there yet
    summary         the line that is left on standard error
    stats_page, stats_document   numbers for people, and as JSON
    text_table      columns of text
"""
