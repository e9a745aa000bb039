"""Counts in sentences that a person reads."""

from __future__ import annotations


def counted(count: int, noun: str) -> str:
    """Like "1 mode", "2 modes", "1,200 contacts": the noun with an s but of one thing."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"
