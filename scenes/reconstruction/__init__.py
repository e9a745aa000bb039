"""A mesh from views of an object without a model."""
