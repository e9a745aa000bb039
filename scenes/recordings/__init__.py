"""Frames, and captures on disk."""
