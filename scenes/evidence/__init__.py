"""The table of evidence, and what scores, moves and compares poses by it."""
