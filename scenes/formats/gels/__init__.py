"""Public recordings of gel sensors as captures."""
