"""What measures the program: its speed and the quality of its framer. Never a timed test."""
