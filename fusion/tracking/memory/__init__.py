"""What a track remembers from frame to frame, and learns of a recording."""
