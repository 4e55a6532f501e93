"""The pane of statistics: how full the wires are, how even the frames come, what goes wrong when.

flags    what flag bytes told of each motor, in words
page     the numbers as lines of text
widget   the pane
"""
