"""The regression that tells how likely an answer is right: its answers, its fit, its tables."""
