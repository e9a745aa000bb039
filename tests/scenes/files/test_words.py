"""Counts in sentences."""

from scenes.words import counted


def test_one_thing_has_no_s():
    assert [counted(n, "mode") for n in (0, 1, 2, 1200)] == ["0 modes", "1 mode", "2 modes", "1,200 modes"]
