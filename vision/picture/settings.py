"""How a predicted picture is scored: what a pose earns and loses by it. Nats, metres, pixels."""

from __future__ import annotations

from dataclasses import dataclass

from scenes.errors import InputError

# Share of an upright box's area below which a grid lies along the outline's own axes, of rays as of aspects. By
# judgement: a compact thing keeps its grid, a stick aslant would be met by a tenth of it.
SLENDER = 0.7


@dataclass(frozen=True)
class PictureScore:
    """Nats of what a predicted picture shows, each of a whole outline."""

    # What is seen where it must be earns this, up to this share (no unit) of the outline: more of it tells no more.
    seen: float = 100.0
    most_seen: float = 1.0
    # What is seen on parts of one colour that go on beyond the outline costs this, as far as they do.
    goes_on: float = 0.0
    # What the camera sees past costs this, and beside what nothing hides this; something unknown in front this: of a
    # right pose little is seen past, and what hides it is somewhere by chance.
    past: float = 200.0
    past_open: float = 0.0
    hidden: float = 30.0
    # An outline over which a surface runs on: that is another thing, of which a part is covered.
    runs_on: float = 60.0
    # As many borders as a whole outline has, across which the surface that agrees runs on to be what hides the object:
    # it goes through another thing. And the most that they cost, since a finger may lie against the object smoothly.
    within: float = 0.0
    most_within: float = 0.0
    # An outline at which what agrees ends in a step of depth, as an object does that is really there, earns this; one
    # beyond which nothing is read, this: stereo and structured light are blind in the shadow beside an object.
    ends: float = 0.0
    dark: float = 0.0
    # What agrees and is off by one sigma of noise and bias from place to place costs this: six parameters lay a surface
    # onto another of about its size, but not its form.
    scatter: float = 0.0
    # Power (no unit) of an outline's size by which all this counts: 1 as there are more cells, 1/2 as its border is
    # longer, 0 as a shape is a shape.
    by_size: float = 1.0

    @property
    def nats(self) -> tuple[float, ...]:
        """As `scoring_kernels.cost_of_shares` takes them."""
        shares = self.seen, self.most_seen, self.goes_on, self.past, self.past_open, self.hidden
        border = self.runs_on, self.within, self.most_within, self.ends, self.dark
        return *shares, *border, self.scatter, self.by_size


@dataclass(frozen=True)
class CoverSettings:
    """How a fit is drawn over what of a mask it leaves bare. By judgement, on the tuning families with their masks."""

    # Places looked at over the object's depth for that nearest to it on a ray, and again between two of those: to a
    # sixtieth of the radius, far below sigma.
    steps: int = 12
    # Metres: what a mask's border is off by, a pixel or two at arm's length.
    sigma: float = 0.003
    # Sigmas beyond which a ray draws no more: what is farther belongs to another pose. Of twice as many the answers
    # were as good.
    gate: float = 5.0
    # Pixels that a whole mask is worth, if all of it is bare: few beside those that a fit takes. Of four times as many
    # the answers were as good.
    amount: float = 32.0


@dataclass(frozen=True)
class PredictionSettings:
    """How a predicted image is scored. By judgement, on generated captures and on nine recorded frames, which are
    therefore no independent test of it.
    """

    # Rays along each side of the box around the outline: some six in ten of their square meet the object.
    side: int = 16
    # That box is upright; it lies along the outline's own axes where these hold less than this share of its area.
    slender: float = SLENDER
    # The same where pixels are wanted as rows of evidence: first, and where that shows fewer than so many pixels.
    sides_rows: tuple[int, int] = (40, 64)
    enough_rows: int = 450
    # Things of which less than this share of what is seen is off the edge are thin: then edges count, too.
    thin_share: float = 0.4
    # Depths (m) beyond where a ray that is seen past meets the object, at which it must be empty; the distance kept
    # from what is seen, sigma (m) and gate (sigmas) of these rows.
    empty_depths: tuple[float, ...] = (0.002, 0.006, 0.014)
    empty_clearance: float = 0.006
    empty_sigma: float = 0.003
    empty_gate: float = 3.0
    # Points of the surface whose projections bound the outline.
    bounding: int = 200
    # Independent cells that a whole outline amounts to: neighbours share what is in front of them. With 100 the
    # few that are seen at 90 % hidden outvoted touch (tuning family `d435`); with 50 nothing else changed there.
    cells: float = 50.0
    # Pixels (px^2) that a cell has at least: a camera smears its noise over as many. And the least share of all cells
    # that a small outline amounts to: a bottle seen from its end, an object far away.
    cell: float = 25.0
    least_cells: float = 0.2
    # What a picture is worth where the robot's hand is known; and where nobody knows what hides the object, with a mask
    # and without. The latter is between what a conditional logit makes of proposals to nine tuning families
    # (docs/evaluation.md), whose minima are too narrow to be found, and what counts pixels: of 288 of their frames by
    # vision, hand and mask kept back, 256 are right with a start and 184 without (with pixels 242 and 170, as fitted
    # 233 and 180); with a mask 266 and 229 (251 and 201). Fitted anew to what many pairs of pixels propose, `seen` all
    # but vanishes; without a start 8 more were right then, and with one 16 fewer.
    known_hand: PictureScore = PictureScore()
    unknown_hand: PictureScore = PictureScore(
        seen=60.0,
        most_seen=0.4,
        goes_on=70.0,
        past=120.0,
        past_open=20.0,
        hidden=0.0,
        runs_on=90.0,
        within=20.0,
        most_within=6.0,
        ends=40.0,
        dark=25.0,
        scatter=15.0,
        by_size=0.5,
    )
    # Of thousands of poses first so many points are compared, with an image of so many pixels to one.
    glimpse_points: int = 24
    glimpse_step: int = 2
    # What these are worth (nats of a whole outline): seen past, seen, and up to which share (no unit). Here pixels
    # count: nothing else is told.
    glimpse_past: float = 120.0
    glimpse_seen: float = 60.0
    glimpse_most: float = 0.4
    # Surfaces of the image are numbered at every so many pixels.
    piece_step: int = 3
    # Share of a part of one colour that may be beside the outline for how edges are smeared, and colours lie beside
    # depth.
    beside: float = 0.15
    # A pixel that is seen past counts this share beside the edge of something that is as near as the object.
    past_beside: float = 0.25
    # Of what gives no reading this share is left out of the count.
    unread: float = 0.7
    # A cell's depth agrees within so many sigmas (noise, smooth bias and scale); seen fades with so many (no scale).
    tolerance: float = 2.5
    fading: float = 1.5
    # How far (m, and share of depth) the next pixel may be from where the seen surface leads.
    smooth: float = 0.003
    smooth_share: float = 0.004
    # Up to this distance (m) depth resolves an object's form. Beyond it a picture counts as much less as the logarithm
    # of one and the object's radius over the tolerance: what may be off by the object's own size agrees with anything.
    # And places that look alike grow in number: as the square of distance across the image, and in proportion along it
    # when every distance is as likely as its double, so many nats for each factor e. By judgement: no tuning family has
    # anything beyond; rooms have.
    resolved_to: float = 1.0
    places: float = 3.0
    # A mask is right to so many pixels: what is seen outside of it is not the object.
    mask_margin: int = 6
    # A whole mask that is outside a pose's outline costs this (nats), as much as a whole outline earns that is seen
    # where nobody knows the hand (by judgement); a part of it in proportion, told by so many of its pixels.
    uncovered: float = 60.0
    masked: int = 64
    cover: CoverSettings = CoverSettings()
    # The hand is drawn at every so many pixels; a reading this near (m) to it is the hand's.
    hand_step: int = 3
    hand_margin: float = 0.006
    # A reading this near (m, and sigmas of its noise on top, as far as it scatters) to the table or wall, or behind it,
    # is the table's or wall's.
    plane_margin: float = 0.004
    plane_sigmas: float = 2.0

    def __post_init__(self) -> None:
        """Refuse steps that lead nowhere."""
        if self.hand_step < 1:
            raise InputError(f"hand_step: expected whole pixels from 1, got {self.hand_step}")
