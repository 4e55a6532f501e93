"""A damaged recording mended: a new file of all that is whole in the old one.

It must not know how the user is told.

    repair     the old file looked through twice, and the new one written
    believed   which of the definitions found in it are used
    unpacked   the messages of a chunk, whatever they say
"""
