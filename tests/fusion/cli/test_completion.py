"""Completion scripts: what the shells make of them, and that every command and option is in."""

import shutil
import subprocess

import pytest

from fusion.cli.completion import SHELLS, bash, described, fish, zsh
from fusion.cli.main import main
from fusion.cli.parser import COMMANDS, build_parser


@pytest.mark.parametrize("make", [bash, zsh, fish])
def test_every_command_and_option_is_in(make):
    commands = described(build_parser())
    assert set(commands) == {module.__name__.rpartition(".")[2].replace("_", "-") for module in COMMANDS}
    text = make(commands)
    for name, command in commands.items():
        assert name in text
        for option in command.options:
            for flag in option.names:
                assert (flag if make is not fish else flag.lstrip("-")) in text


def complete(words: str) -> list[str]:
    """What bash offers for the last of these words."""
    script = bash(described(build_parser()))
    parts = words.split(" ")
    listed = " ".join(f"'{word}'" for word in parts)
    line = f"COMP_WORDS=({listed}); COMP_CWORD={len(parts) - 1}; _palpate; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    run = subprocess.run(["bash", "-c", f"{script}\n{line}"], capture_output=True, text=True, check=True, cwd="/")
    assert run.stderr == ""
    return run.stdout.split()


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_bash_completes():
    assert complete("palpate gra") == ["grasp"]
    assert complete("palpate grasp --fric") == ["--friction"]
    assert complete("palpate grasp --norm l") == ["l1", "linf"]
    assert complete("palpate completion z") == ["zsh"]


@pytest.mark.parametrize("shell", SHELLS)
def test_the_shell_itself_accepts_the_script(shell, tmp_path, capsys):
    assert main(["completion", shell]) == 0
    script = tmp_path / "script"
    script.write_text(capsys.readouterr().out)
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell}")
    assert subprocess.run([shell, "-n", str(script)], capture_output=True, check=False).returncode == 0


def test_another_shell_is_one_line(capsys):
    assert main(["completion", "csh"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
