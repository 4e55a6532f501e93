"""The pane of motors: what each was asked, what it tells, and both over time.

look     what is looked at: the states and traces at a row, over a window of time; no Textual
plot     what was asked and told over time, in braille
card     one motor in a rectangle of text
flag_lines   what the card says of ERROR and ONLINE
widget   the pane: cards in a grid that suits its size
"""
