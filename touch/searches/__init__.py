"""Contact methods of the theses and of others, one file a method, each with a function `localize`."""
