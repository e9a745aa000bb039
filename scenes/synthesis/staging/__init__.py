"""Scenes as they are: tables, walls, neighbours, mounts, prints, and meshes that are not quite the object's."""
