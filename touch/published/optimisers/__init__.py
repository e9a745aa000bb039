"""Minimisers of the published cost functions: by descent, by simplices of boxes, by chance."""
