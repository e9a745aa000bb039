"""One file a command: `add_arguments` and `run`, and the first line of its docstring is its help."""
