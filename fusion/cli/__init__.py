"""The command `palpate`: parser, options, and the one place for errors; working parts load when a command runs."""
