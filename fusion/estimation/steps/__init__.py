"""The steps of an estimate that are also asked for by themselves."""
