"""A look at machine, folder and ports, and at what one line carries.

It must not know how it is told, and changes nothing.

    examination    all there is to look at, in order
    surroundings   its words on the folder, the terminal and the installation
    verdicts       its words on a line's bytes
"""
