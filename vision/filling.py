"""Readings that no camera made: what recorders put into holes beside the edges of things.

A depth camera sees no second time what stands behind an edge: stereo and projected light leave a shadow there, time of
flight mixes the two. An image whose steps nearly all lie between neighbours had its holes filled, by viewers mostly
with the nearest, the left or the farthest reading beside the hole; along a row or a column that is a run of one value
that begins at a step. It says what the filter believes and not where the surface is, but looks like background or
object that was seen. Such runs are made holes again.

Images that were rendered without noise have bare steps, too, and runs of one value where a surface faces the camera.
Noise goes up and down from reading to reading, smooth surfaces do not; where an image shows none, only runs that are
short, lie along a row and go on as the same surface are taken for filled in.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from scenes.recordings.frames import Frame
from scenes.words import counted
from vision import filling_kernels as kernels


@dataclass(frozen=True)
class FillingSettings:
    """When an image is taken for filled, and what is then not believed. Tuned on the tuning families, filled."""

    # A step: depths of neighbours in a row that differ by more (m), the nearer no farther off than this (m).
    step: float = 0.015
    farthest: float = 1.5
    # Rows of which steps are counted (every so many px), and steps (their number) without which nothing is told.
    stride: int = 8
    fewest: int = 6
    # Share of the steps across a gap up to which an image was filled: families of formulas have 0.06 and more, those
    # of optics 0.11 and more, filled ones 0.
    gaps: float = 0.02
    # Readings of one value in a row (px) that are no coincidence; in images without noise, more than a shadow has.
    run: int = 4
    longest: int = 64
    # An image has noise when of its changes from reading to reading so many (share) go back, and its equal neighbours
    # are not more (share): tuning families 0.05 to 0.8 and mostly up to 0.85, filled or not; without noise up to 0.033,
    # and in whole millimetres up to 0.18, but then from 0.88 on.
    turning: float = 0.045
    equal: float = 0.85


def as_measured(frame: Frame, settings: FillingSettings | None = None) -> tuple[Frame, tuple[str, ...]]:
    """The frame without the readings that were filled in beside edges, and a note of how many; the frame itself and no
    note where the image has its holes.
    """
    s = settings or FillingSettings()
    if frame.depth is None:
        return frame, ()
    depth = np.ascontiguousarray(frame.depth, dtype=np.float32)
    steps, gaps, pairs, equal, changes, turns = kernels.look_at_rows(depth, s.step, s.farthest, s.stride)
    if steps < s.fewest or gaps > s.gaps * steps:
        return frame, ()
    noisy = turns >= s.turning * changes > 0 and equal <= s.equal * pairs
    bare = depth.copy()
    dropped = kernels.drop_runs(depth, s.step, s.farthest, s.run, 0 if noisy else s.longest, bare)
    if noisy:
        columns, turned = np.ascontiguousarray(depth.T), np.ascontiguousarray(bare.T)
        dropped += kernels.drop_runs(columns, s.step, s.farthest, s.run, 0, turned)
        bare = np.ascontiguousarray(turned.T)
    if not dropped:
        return frame, ()
    note = f"the depth image has no holes: {counted(dropped, 'reading')} filled in beside edges are not used"
    return replace(frame, depth=bare), (note,)
