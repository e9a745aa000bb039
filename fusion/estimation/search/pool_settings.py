"""How many poses compete in a search, how they are fitted, and what convinces. Nats, metres, radians, shares."""

from __future__ import annotations

from dataclasses import dataclass, field

from scenes.evidence.align import AlignSettings


@dataclass(frozen=True)
class PoolSettings:
    """How many poses compete, and how they are fitted to what is seen of them. Tuned on generated captures."""

    # Poses that touch alone proposes; and without a start so many that it ends in are ranked by the whole objective
    # first: many explain all of few contacts (of 50 or 150 the same were found on frames of another generator).
    by_touch: int = 8
    felt_kept: int = 50
    # Starts near a prior from which pixels alone are descended to, the prior's own pose first, in one round after the
    # other; blurs (m) of the passes, as ICP's shrinking gates; steps of each, and rows.
    descents: tuple[int, ...] = (8, 24, 32)
    descent: tuple[float, ...] = (0.02, 0.01, 0.005, 0.002)
    descent_steps: int = 6
    descent_rows: int = 160
    # Poses, the best first, that are fitted to the pixels inside their own outlines, at first and when what competed
    # does not convince; by how many rays along each side in each round; the fewest such pixels.
    fitted: int = 6
    fitted_in_doubt: int = 12
    sides: tuple[int, ...] = (24, 40)
    least_pixels: int = 25
    # A pose that costs so many nats more than the best is not fitted, but for a few, and after a first fit not again:
    # nine in ten ends of walks gained up to 14 by a fit, one in a hundred 23; a pose that touch proposes may gain more.
    hopeless: float = 25.0
    always_fitted: int = 4
    # Rows of vision in a first fit, which only leads to the pixels of the second.
    first_rows: int = 160
    # Steps of a fit, and where it ends (rad, m): pixels change sides before a tenth of their noise.
    fit: AlignSettings = field(
        default_factory=lambda: AlignSettings(iterations=15, tolerance_angle=2e-4, tolerance_distance=2e-5)
    )
    # An answer convinces, and no more is searched, when the shares of its predicted pixels that are seen past, and of
    # its outline that runs on, are at most these, what agrees is at least this share of what is read and not hidden,
    # and of the whole; the first mode holds this share, and touch costs at most so many nats a contact.
    most_past: float = 0.05
    # Where nobody knows what hides the object, what runs on over its outline is most often another thing: shares.
    most_runs_on: float = 0.3
    most_runs_on_unknown: float = 0.1
    # Share of borders within the outline, beside as many as it has, across which what agrees runs on to be what hides
    # the object: an object that goes through another thing. 2 in 100 right answers have more; a box among unknown
    # fingers that met all contacts 19 mm off had a quarter.
    most_within: float = 0.15
    least_agree: float = 0.8
    least_shown: float = 0.12
    # The same share near a prior where contacts hold the object and it is known what hides it: of 248 such answers of
    # tuning families as many were right with 0, 0.05 and 0.12, but with 0 one more was missed where 2 % are seen.
    least_shown_felt: float = 0.05
    sure_share: float = 0.9
    # A mode that costs so many nats more than the first takes nothing from its share: where few pixels are left inside
    # an outline, a mode is wide because nothing is known there, and Laplace's method takes width for weight.
    surely_apart: float = 8.0
    # Nats that a round may gain where it ends in the pose of the one before, for that to be the end.
    as_likely: float = 3.0
    # What agrees with at least this share of the whole is clearly seen: then nothing more is proposed.
    clearly_shown: float = 0.35
    contact_nats: float = 3.5
    # Fingers whose contacts hold an object in place: three points, for those of one finger lie next to each other. A
    # picture that so many agree with is no other thing's.
    tying_fingers: int = 3
    # What convinces may still be one of several that do: it explains what is seen, and nothing around it is tried, when
    # at least this share of the whole agrees, and at most these shares are seen past and run on over its outline. Of
    # 107 answers of the tuning families that convinced (half of them where nobody knows the hand), a walk bettered 44
    # by more than 3 nats, but 1 of the 17 in 59 that passed these limits there.
    # And of what neither the hand nor anything else hides this share must agree.
    explained: float = 0.3
    explained_share: float = 0.9
    explained_past: float = 0.01
    explained_runs_on: float = 0.03
    # And where nobody says what hides the object, the picture may cost at most this (nats): agreeing is not enough
    # where it ends nowhere and scatters. A light bulb in a hand that agreed so cost 13 where the truth earned 23.
    most_against: float = 0.0
    # The same of what few starts near a prior end in, shares: of the whole, of what nothing hides where at least
    # `tying_fingers` agree and where not, seen past, runs on. Of 416 answers with a start of the tuning families 162
    # passed; the whole search ended each of them in the same valley, and none that passed was wrong.
    glance_shown: float = 0.2
    glance_share_felt: float = 0.85
    glance_share: float = 0.9
    glance_past: float = 0.03
    glance_runs_on: float = 0.03
    # Share of the whole that agrees from which on what a glance finds ends the search where it is known what hides the
    # object, if neither turned poses nor draws around it are likelier. Of 30 such answers of tuning families the whole
    # search ended each within a millimetre; of 18 of which less agreed it ended 3 nearer to the truth by 2 to 3 mm.
    glance_enough: float = 0.25
    # Nats by which what nearly looks the same, turned by a near symmetry, must cost more for a glance to tell them
    # apart: where it costs less, the whole search lays each onto what is seen.
    glance_apart: float = 8.0
    # Nats by which one drawn around it must be likelier for the best to be in doubt after all.
    bettered: float = 2.0
    # The same (nats) where a glance found what is as likely, for a walk to be asked after all.
    hardly: float = 1.0
    # Poses nearer to each other than this share of the distance at which modes are one go on as one.
    together: float = 0.5
    # Poses of a search's pass that are nearer to each other than this share of `apart` go on as one.
    passes_apart: float = 0.5
    # Fewest pixels that a glance begins with: of fewer no normals are told.
    glanced_pixels: int = 100
    # Steps by which turned poses are laid onto what is seen of the best, and rows. Of these, and of draws around the
    # best, those are fitted that cost at most so many nats more before: nine in ten ends of walks gained up to 14.
    turned_steps: int = 8
    turned_rows: int = 80
    promising: float = 15.0
    # Poses that a walk begins at, of all that are proposed: the best, where nothing is known, not even what hides the
    # object, and else (of 549 answers with a start no verdict was another with 400; of 296 by vision without one as
    # many were missed).
    sifted: int = 400
    sifted_near: int = 120
    # Of very many pairs' poses so many pass a glimpse of a few of their points and are ranked by aspects: of the twenty
    # that aspects rank first all were among 2200 of ten to twenty thousand. Tuned with the pairs that there are
    # (ProposalSettings.paired).
    glimpsed: int = 2000
