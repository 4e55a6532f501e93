"""Owns `python -m fte_sniff`: the same program as `fte-sniff`. It knows only the door."""

from fte_sniff.cli import main

if __name__ == "__main__":
    main()
