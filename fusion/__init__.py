"""One answer from both senses, and everything a user runs."""
