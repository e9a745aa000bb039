"""One frame, one answer."""
