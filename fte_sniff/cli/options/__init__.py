"""What commands have in common on the command line and in the settings file.

They must not know any command.

    filtering, keeping, spans   `--filter`, `--keep-rows`, `--from` and `--to`
    listing                     `--format` of what lists something else than rows
    units, paths, seconds       turns, file names and times, as people write them
    settings, settings_file     what can be set, and the file where it lies
    remembered                  which settings hold, and how a screen's choices get there
"""
