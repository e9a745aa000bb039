"""The world: things with geometry, and recordings of them."""
