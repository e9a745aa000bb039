"""Completion scripts: what the shells make of them, and that every command and option is in."""

import argparse
import shutil
import subprocess

import pytest

from fusion.cli.commands.install.completion import SHELLS, commands, script
from fusion.cli.main import main
from fusion.cli.parser import COMMANDS, build_parser

# Shells whose completions name options without their dashes.
SHORT = ("fish", "tcsh")


@pytest.mark.parametrize("shell", SHELLS)
def test_every_command_and_option_is_in(shell):
    parser = build_parser()
    listed = commands(parser)
    assert set(listed) == {module.__name__.rpartition(".")[2].replace("_", "-") for module in COMMANDS}
    text = script(parser, shell)
    for name, command in listed.items():
        assert name in text
        for action in command._actions:
            for flag in action.option_strings if action.help != argparse.SUPPRESS else ():
                assert (flag.lstrip("-") if shell in SHORT else flag) in text


@pytest.fixture(scope="module")
def offered():
    """What bash offers for the last of these words, in the root folder."""
    text = script(build_parser(), "bash")

    def complete(words: str) -> list[str]:
        parts = words.split(" ")
        listed = " ".join(f"'{word}'" for word in parts)
        line = f"COMP_WORDS=({listed}); COMP_CWORD={len(parts) - 1}; _shtab_palpate; "
        line += "printf '%s\\n' \"${COMPREPLY[@]}\""
        run = subprocess.run(["bash", "-c", f"{text}\n{line}"], capture_output=True, text=True, check=True, cwd="/")
        assert run.stderr == ""
        return run.stdout.split()

    return complete


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_bash_completes(offered):
    assert offered("palpate gra") == ["grasp"]
    assert offered("palpate grasp --fric") == ["--friction"]
    assert offered("palpate grasp --norm l") == ["l1", "linf"]
    assert offered("palpate completion z") == ["zsh"]


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.parametrize("words", ["validate", "estimate --config", "batch --workers 2 --out", "view etc"])
def test_bash_completes_files_where_there_are_no_choices(offered, words):
    assert offered(f"palpate {words} et") == ["etc"]


@pytest.mark.parametrize("shell", SHELLS)
def test_the_shell_itself_accepts_the_script(shell, tmp_path, capsys):
    assert main(["completion", shell]) == 0
    path = tmp_path / "script"
    path.write_text(capsys.readouterr().out)
    if shutil.which(shell) is None or shell == "powershell":  # which has no such switch
        pytest.skip(f"no {shell} that checks a script")
    assert subprocess.run([shell, "-n", str(path)], capture_output=True, check=False).returncode == 0


def test_another_shell_is_one_line(capsys):
    assert main(["completion", "csh"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
