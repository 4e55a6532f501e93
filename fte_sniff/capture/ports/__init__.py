"""One port: found, opened, had or not, and its driver's habits.

It must not know what is done with the bytes, nor when they came.

    opening      opening a port, and what can go wrong with it
    granted      what an open port is asked for before it is read
    reading      taking what has arrived from any kind of port
    line_errors  what a UART reports of bytes in error, counted and marked
    latency      how soon a driver hands on what it has
    identity     what a lost port is known by
    listing      the ports that are plugged in
    adapters     USB adapters that have become no port
    refusal, permission, holders   why a port cannot be had, and the way out
    wording      what its errors say, as far as that is known, for other languages
"""
