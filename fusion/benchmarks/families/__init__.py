"""Families of frames: what may be tuned on, what is only ever reported (docs/evaluation.md)."""
