"""What sensors do to the truth."""
