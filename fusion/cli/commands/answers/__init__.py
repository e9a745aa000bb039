"""Commands that say where the object is, which it is, and how to grasp it."""
