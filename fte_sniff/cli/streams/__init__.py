"""The standard streams and signals of a command that runs on.

They must not know what it does.

    telling   what is said on standard error
    stdout    standard output, and what becomes of it when nobody reads on
    signals   how a command hears of its end
"""
