"""Commands that make, change, check and show captures and meshes."""
