"""Tactile arrays: from the pressures of taxels to a descriptor, to costs over poses, and to rows of evidence."""
