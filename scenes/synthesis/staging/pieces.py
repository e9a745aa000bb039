"""What a scene is made of besides the object and what hides it: small pieces, each by its name, joined with "+"."""

from __future__ import annotations

from dataclasses import dataclass

from scenes.errors import unknown

# Name -> what it adds, as `palpate synth --help` says it.
PIECES = {
    "table": "a table: the object lies on it, or hand and object are above it; seen from 30 to 60 degrees above",
    "wall": "a wall behind the table",
    "adapter": "boxes on the hand that its model lacks",
    "print": "a printed object in rgb",
    "unknown-hand": "the hand is in the picture, but the frame tells nothing of it",
}


@dataclass(frozen=True)
class Staging:
    """Which pieces a scene has; without any: a wide wall somewhere behind (see SynthesisSettings.background)."""

    table: bool = False
    wall: bool = False
    adapter: bool = False
    printed: bool = False
    hand_known: bool = True

    @property
    def name(self) -> str:
        """As `staged` reads it."""
        there = (self.table, self.wall, self.adapter, self.printed, not self.hand_known)
        return "+".join(piece for piece, has in zip(PIECES, there, strict=True) if has)


def staged(scene: str | Staging | None) -> Staging:
    """The pieces of "table+wall", or those given. Raises InputError, listing the names, for an unknown piece."""
    if isinstance(scene, Staging):
        return scene
    names = [name.strip() for name in (scene or "").split("+") if name.strip()]
    for name in names:
        if name not in PIECES:
            raise unknown("scene", name, PIECES)
    return Staging("table" in names, "wall" in names, "adapter" in names, "print" in names, "unknown-hand" not in names)
