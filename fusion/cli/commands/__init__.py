"""One file a command, by what they are for: `add_arguments` and `run`; its docstring begins with its help."""
