"""Ports as iterables of chunks and port events, each stamped once.

They must not know of frames.

    items        what a source is, whatever it reads; how a line is got at
    threaded     the life of a source that reads in a thread of its own
    backlog      the bounded way from reading threads to the consumer
    source       an open port as a source
    returning    how a lost port is waited for
    lateness     how much earlier than they are stamped bytes may have come
    merged       several sources as one, on one time line
    tap          listening: one port, or one for each of two wires
    listening    listening to a port for a while, to judge its line by
"""
