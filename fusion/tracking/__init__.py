"""Frame after frame with both senses."""
