"""One frame of a track, step by step: predict, sense, glance or refine, read the print, judge."""
