"""Shapes and where they are: poses, cameras, meshes, their signed-distance lattices, symmetries, rendering."""
