"""The command `palpate`: one module a subcommand, imported light, working parts loaded when a command runs."""
