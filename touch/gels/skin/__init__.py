"""From a gel's image to its skin: what colours differ by, slopes, depths, and what the colours are worth."""
