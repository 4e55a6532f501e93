"""fte-sniff."""
