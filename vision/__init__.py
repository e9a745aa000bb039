"""From RGB-D to object pixels, free space and a coarse pose."""
