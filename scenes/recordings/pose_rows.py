"""Which rows of a poses.csv are a capture's: a file of a benchmark holds those of many scenes and objects."""

from __future__ import annotations

from collections.abc import Sequence

from scenes.errors import InputError
from scenes.recordings.bop import PoseRow
from scenes.recordings.captures import Capture


def rows_of(rows: Sequence[PoseRow], capture: Capture, where: str = "poses") -> list[PoseRow]:
    """The rows of the capture's object and scene, in their order.

    A capture that notes no scene has the rows of any one. Raises InputError, beginning with `where`, when there are
    rows and none of them is the capture's, when they are of several scenes and the capture's is not known, and for a
    frame that it does not have.
    """
    object_id, scene_id = capture.manifest.object_id, capture.manifest.notes.get("scene_id")
    own = [row for row in rows if row.obj_id == object_id]
    if rows and not own:
        raise InputError(f"{where}: expected rows of obj_id {object_id} ({capture.path}), got obj_id {rows[0].obj_id}")
    scenes = sorted({row.scene_id for row in own})
    if isinstance(scene_id, int):
        if own and scene_id not in scenes:
            got = f"got scene_id {scenes[0]}"
            raise InputError(f"{where}: expected rows of scene_id {scene_id} ({capture.path}), {got}")
        own = [row for row in own if row.scene_id == scene_id]
    elif len(scenes) > 1:
        listed = ", ".join(map(str, scenes[:4])) + (", …" if len(scenes) > 4 else "")
        said = 'say which is its own: "scene_id" in the notes of its capture.json'
        raise InputError(f"{where}: expected rows of one scene ({capture.path}), got scene_id {listed}: {said}")
    strangers = sorted({row.im_id for row in own} - set(capture.frame_ids))
    if strangers:
        raise InputError(
            f"{where}: expected frames of {capture.path}, got im_id {strangers[0]}, which it does not have"
        )
    return own


def best_rows(rows: Sequence[PoseRow], capture: Capture, where: str = "poses") -> dict[int, PoseRow]:
    """Of the rows that are the capture's, by frame the one with the best score; raises InputError as `rows_of` does."""
    return {row.im_id: row for row in sorted(rows_of(rows, capture, where), key=lambda row: row.score)}
