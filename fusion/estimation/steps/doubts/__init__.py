"""What came with a frame, and whether the rest of it contradicts that."""
