"""Motions that leave an object, or most of it, where it was, and poses that look alike."""
