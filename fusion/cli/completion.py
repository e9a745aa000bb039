"""Print a shell's completion script: commands, options and choices, as the parser has them."""

from __future__ import annotations

import argparse

from fusion.cli.options import say, write_json

SHELLS = ("bash", "zsh", "fish")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    parser.add_argument("shell", choices=SHELLS, help="source what this prints, see docs/commands.md")


def run(args: argparse.Namespace) -> int:
    """Write the script to standard output."""
    commands = described(args.parser)
    write_json(args.json, {"shell": args.shell, "commands": sorted(commands)})
    say({"bash": bash, "zsh": zsh, "fish": fish}[args.shell](commands).rstrip("\n"))
    return 0


class Option:
    """One option: its names, what it is for, the choices of its value (empty: files), whether it takes one."""

    def __init__(self, action: argparse.Action) -> None:
        """From argparse's own."""
        self.names = list(action.option_strings)
        self.help = _plain(action.help)
        self.choices = [str(choice) for choice in action.choices or ()]
        self.takes = action.nargs != 0


class Command:
    """One command: what it does, its options, the choices of its first argument."""

    def __init__(self, parser: argparse.ArgumentParser) -> None:
        """From its parser."""
        own = [action for action in parser._actions if action.help != argparse.SUPPRESS]
        self.help = _plain(parser.description).split(";")[0].split(":")[0].rstrip(".")
        self.options = [Option(action) for action in own if action.option_strings]
        self.choices = [str(c) for action in own if not action.option_strings for c in action.choices or ()]


def described(parser: argparse.ArgumentParser) -> dict[str, Command]:
    """The commands of a parser by name."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return {name: Command(sub) for name, sub in action.choices.items()}
    return {}


def _plain(text: str | None) -> str:
    """Without what a shell or a completion system would read."""
    kept = "".join(c for c in (text or "") if c not in "'\"`$\\[]{}%")
    return " ".join(kept.split())


def bash(commands: dict[str, Command]) -> str:
    """For bash: words by command, choices by option, files elsewhere."""
    cases, values = [], []
    for name, command in commands.items():
        words = [n for option in command.options for n in option.names] + command.choices
        cases.append(f"    {name}) words='{' '.join(words)}' ;;")
        for option in command.options:
            if option.choices:
                keys = "|".join(f"{name}:{n}" for n in option.names)
                values.append(f"    {keys}) choices='{' '.join(option.choices)}' ;;")
    newline = "\n"
    return f"""# palpate: completion for bash
_palpate() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" words='' choices=''
  if [ "$COMP_CWORD" -eq 1 ]; then
    COMPREPLY=($(compgen -W '{" ".join([*commands, "--help", "--version"])}' -- "$current"))
    return
  fi
  case "${{COMP_WORDS[1]}}:$before" in
{newline.join(values)}
  esac
  if [ -n "$choices" ]; then
    COMPREPLY=($(compgen -W "$choices" -- "$current"))
    return
  fi
  case "${{COMP_WORDS[1]}}" in
{newline.join(cases)}
  esac
  COMPREPLY=($(compgen -W "$words" -- "$current") $(compgen -f -- "$current"))
}}
complete -o filenames -F _palpate palpate
"""


def zsh(commands: dict[str, Command]) -> str:
    """For zsh: descriptions too."""
    names = "\n".join(f"    '{name}:{command.help}'" for name, command in commands.items())
    cases = []
    for name, command in commands.items():
        lines = []
        for option in command.options:
            values = f"({' '.join(option.choices)})" if option.choices else "_files"
            value = f":value:{values}" if option.takes else ""
            text = option.help.replace(":", " ")
            lines += [f"        '{n}[{text}]{value}'" for n in option.names]
        rest = f"({' '.join(command.choices)})" if command.choices else "_files"
        lines.append(f"        '*:file:{rest}'")
        cases.append(f"      {name}) _arguments \\\n" + " \\\n".join(lines) + " ;;")
    return (
        "#compdef palpate\n# palpate: completion for zsh\n_palpate() {\n  local -a commands\n  commands=(\n"
        + names
        + "\n  )\n  if (( CURRENT == 2 )); then\n    _describe command commands\n    return\n  fi\n"
        + "  local command=$words[2]\n  shift words\n  (( CURRENT-- ))\n  case $command in\n"
        + "\n".join(cases)
        + "\n  esac\n}\ncompdef _palpate palpate\n"
    )


def fish(commands: dict[str, Command]) -> str:
    """For fish: one line an option."""
    lines = ["# palpate: completion for fish"]
    for name, command in commands.items():
        lines.append(f"complete -c palpate -n __fish_use_subcommand -f -a {name} -d '{command.help}'")
        where = f"complete -c palpate -n '__fish_seen_subcommand_from {name}'"
        for option in command.options:
            flags = " ".join(f"-l {n[2:]}" if n.startswith("--") else f"-s {n[1:]}" for n in option.names)
            value = f" -x -a '{' '.join(option.choices)}'" if option.choices else " -r" if option.takes else ""
            lines.append(f"{where} {flags}{value} -d '{option.help}'")
        if command.choices:
            lines.append(f"{where} -f -a '{' '.join(command.choices)}'")
    return "\n".join(lines) + "\n"
