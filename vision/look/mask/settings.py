"""What is taken for table, hand and object. Metres, pixels, shares."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MaskSettings:
    """What is taken for table, hand and object. Tuned on generated captures."""

    # Room around a start's ball in which the object is looked for, metres: T1's coarse starts are 33 mm off.
    slack: float = 0.035
    # Pixels of the whole image among which the hand is looked for, where nobody has yet.
    most_hand: int = 8000
    # A plane holds this share of the readings, and fills this share of the image: table and wall fill 29 % and more in
    # all families and recordings, a hand and what it holds, alone in the image, 6 %. So many triples of points are
    # tried, on so many points, of which every so manieth has a vote on them.
    plane_share: float = 0.2
    plane_image: float = 0.12
    plane_tries: int = 200
    plane_points: int = 3000
    plane_voters: int = 3
    # Room over the plane (m) that is still the plane's: smooth bias and scale of depth at two sigmas; and sigmas of the
    # independent noise on top.
    plane_margin: float = 0.006
    plane_sigmas: float = 3.0
    # Table, wall and floor; of all readings a further plane holds this share: with half of that a hand and what it
    # holds were one (tuning family `stranger`).
    most_planes: int = 3
    next_plane_share: float = 0.2
    # Readings scatter about a plane less than so many times as far as is believed of the camera: else it is no plane.
    plane_most_scatter: float = 5.0
    # What goes on behind the first plane is cut by it: most of it, a share of its readings, in parts of the image of so
    # many points, up to so many times its room behind it. Those of tuning families have 0.02, of `passive` 0.07.
    plane_most_behind: float = 0.15
    plane_part: float = 8.0
    plane_behind: float = 6.0
    # What is asked for is no farther behind a table (m) than its start is off (T1's are 33 mm): else it is none.
    plane_hides: float = 0.035
    # Readings this near (m) to the rendered hand are the hand's: smooth bias at two sigmas, and the joints' errors.
    hand_margin: float = 0.006
    # The hand's outline is uncertain by this (m): joints wrong by 0.3 degrees over a finger, and the rest of the
    # calibration's error after alignment. Beside it depth alone does not tell hand from object.
    hand_outline: float = 0.001
    # With colour the uncertain strip is this much wider, because colour decides inside it (px).
    colour_strip: int = 6
    # Colour is asked when hand and object differ by this many standard deviations, each known from so many pixels, and
    # from no more than so many; a channel's share varies by at least `colour_floor` within one thing (shading, white
    # balance).
    colour_apart: float = 3.0
    colour_pixels: int = 60
    colour_most: int = 2000
    # The object's colour is looked for this near to the hand's outline (px): what is held is there, clutter rarely.
    colour_around: int = 25
    colour_floor: float = 0.012
    # The truth is no farther (m) from a coarse start than this, anywhere on the object (T1: 33 mm and 16 degrees).
    reach: float = 0.045
    # Neighbouring readings that differ by more (m, and as a share of depth) belong to different things.
    step: float = 0.008
    step_share: float = 0.01
    # Pieces smaller than this (px) are noise.
    smallest: int = 25
    # A held object's pieces are this near (m) to the hand, or to what the fingers felt; clutter is not.
    held: float = 0.015
    # A piece far from the hand counts when its middle is this near (m) to the object at the coarse start.
    explained: float = 0.015
    # The largest piece that the hand may be behind, or whose middle is no farther (m) from the object at the start than
    # starts are off, counts when it is this many times larger than all others together.
    larger: float = 1.0
    may_be: float = 0.033
    # Pieces that together are less than this share of what the object shows on average are rests of the hand, or what
    # nine tenths of hiding leave. Then the largest piece within the object's diameter of the hand counts when it alone
    # is more than that: the far end of a hammer that the hand holds from behind.
    fair_share: float = 0.1
    # A piece is another thing, or not the object alone, when this share of it, the middle of its longest extent, is so
    # many times as long as the object: the rest flies between edges, and noise and bias lengthen it a little.
    longest_share: float = 0.94
    longest: float = 1.15
