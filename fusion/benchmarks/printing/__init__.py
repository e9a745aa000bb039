"""Tables, charts and their provenance."""
