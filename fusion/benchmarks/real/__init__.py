"""Recorded frames: no simulator of ours stands behind their errors."""
