"""Both senses measured, frame by frame."""
