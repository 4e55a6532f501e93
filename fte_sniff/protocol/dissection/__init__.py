"""One row explained, byte by byte: what each byte is, and what is wrong there.

It decides nothing, since the framer has decided, and must not know how it is shown.

    dissect      any row in parts, and in sentences
    anatomy      a frame, field by field
    wreckage     damage, and why it was read no other way
    splitting    a damaged frame as what is left of its front and its end
"""
