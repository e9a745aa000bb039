"""The one thing in view whose shape is known: where the hand is, and what of the image shows it."""
