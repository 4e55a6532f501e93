"""What commands have in common on the command line and in the settings file.

They must not know any command.

    filtering, keeping, spans   `--filter`, `--keep-rows`, `--from` and `--to`
    listing                     `--format` of what lists something else than rows
    units, paths, seconds       turns, file names and times, as people write them
    settings, remembered        the settings file, and how what is chosen on a screen gets there
"""
