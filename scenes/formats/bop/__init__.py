"""BOP data sets to and from captures."""
