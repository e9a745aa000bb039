"""Frame after frame by vision alone."""
