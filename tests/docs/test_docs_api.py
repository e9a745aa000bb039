"""docs/api.md says what the docstrings say, of every public name."""

from __future__ import annotations

import importlib

import docs_commands

import fusion
import scenes
import touch


def builder():
    return docs_commands.script("build_api")


def test_the_page_is_up_to_date():
    made = builder()
    assert made.PAGE.read_text(encoding="utf-8") == made.build(), "run `python docs/build_api.py`"


def test_every_public_name_can_be_imported_and_is_explained():
    made = builder()
    text = made.build()
    for package in (fusion, touch, scenes):
        for name in package.__all__:
            assert f"`from {package.__name__} import {name}`" in text
            assert hasattr(package, name)
    for room, (_, more) in made.ROOMS.items():
        assert f"## {room}\n" in text
        for home, names in more.items():
            module = importlib.import_module(home)
            for name in names:
                assert getattr(module, name).__doc__, f"{home}.{name}"
