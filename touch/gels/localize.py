"""Where is the object, from gels alone? Shapes of patches and pairs of contacts propose, rows sift, shapes judge."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.evidence import table as tables
from scenes.evidence.align import AlignSettings, Prior, costs
from scenes.evidence.modes import ModeSettings, distinct_modes
from scenes.evidence.point_pairs import built_pair_table, pair_table
from scenes.evidence.search import SearchStage, search, starts_of_prior
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from touch.answers import Localization, LocalizeSettings, contact_index, verdict_of
from touch.confidence import asked, judged
from touch.gels.patches import Patch
from touch.gels.proposals import GelProposalSettings, bending_table, propose
from touch.gels.rows import GelRowSettings, gel_contacts, patch_rows, silent_rows
from touch.gels.shapes import Shapes, ShapeSettings, fit_shapes, hessians_at
from touch.multistart import contact_starts
from touch.posterior import draws_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GelSearchSettings:
    """The search over patches. Values by judgement."""

    rows: GelRowSettings = field(default_factory=GelRowSettings)
    proposals: GelProposalSettings = field(default_factory=GelProposalSettings)
    shapes: ShapeSettings = field(default_factory=ShapeSettings)
    # Proposals of pairs of contacts, and starts that only put one contact onto the surface.
    pairs: int = 4000
    loose: int = 800
    # Draws of a prior, when there is one: along what one patch leaves free, shapes and contacts propose little near it.
    drawn: int = 400
    # Blur (share of the object's radius, rad) under which all proposals are ranked, and how many go on.
    rank_blur: tuple[float, float] = (0.05, 0.25)
    ranked: int = 400
    # Of the rows, every so many tell good proposals from bad.
    ranking_step: int = 6
    # Passes of the alignment: blur (share of the radius, rad), steps, survivors.
    passes: tuple[tuple[float, float, int, int], ...] = ((0.04, 0.2, 10, 160), (0.01, 0.06, 12, 80))
    # Shaken by this much (rad, share of the radius), so that other seeds look at other places.
    jitter: float = 0.03
    modes: ModeSettings = field(default_factory=ModeSettings)
    # Share of the rows' weight (GelRowSettings) that covariances are taken from: 95 % regions of simulated presses with
    # a coarse start hold 93 % of the truths with 0.45, 91 % with 0.6, 84 % with 1 (90 presses of seeds that
    # `palpate bench gel` does not use); a little less for what those do not show.
    belief: float = 0.4
    # Several gels hold an object near its middle: standard deviation of their contacts' mean from the centroid, as a
    # share of its radius. Wide: it decides only between poses that the gels cannot tell apart, along a can or a handle.
    middle: float = 0.5
    # When it is `ok`: the way round that looks alike is another mode, and covariances are as wide as they should be.
    verdict: LocalizeSettings = field(default_factory=lambda: LocalizeSettings(way_round=True, widening=1.0))


def gel_starts(
    model: ObjectModel, patches: Sequence[Patch], rng: np.random.Generator, settings: GelSearchSettings | None = None
) -> Array:
    """(n, 4, 4) poses that patches' shapes, pairs of contacts and single contacts speak for; the patches' frame."""
    settings = settings or GelSearchSettings()
    contacts = gel_contacts(patches, settings.rows)
    parts = [propose(model, patch, settings.proposals) for patch in patches]
    if len(contacts) >= 2:
        rotations, origins = pair_table(model).hypotheses(contacts, settings.pairs)
        if len(rotations):
            parts.append(se3.make_poses(rotations, origins))
    if len(contacts):
        parts.append(contact_starts(model, contacts, settings.loose, rng))
    starts = np.concatenate(parts)
    widths = np.repeat([settings.jitter, settings.jitter * model.radius], 3)
    return se3.perturb(starts, widths * rng.normal(size=(len(starts), 6)), model.centroid)


def build_tables(model: ObjectModel, settings: GelSearchSettings | None = None) -> None:
    """What gel_starts looks up in the object: built at the first call and kept, a second's work."""
    settings = settings or GelSearchSettings()
    built_pair_table(model)
    for box in settings.proposals.boxes:
        bending_table(model, box, settings.proposals)


def sifted_starts(
    model: ObjectModel,
    patches: Sequence[Patch],
    rng: np.random.Generator,
    prior: Prior | None = None,
    extra: Evidence | None = None,
    settings: GelSearchSettings | None = None,
) -> Array:
    """(n, 4, 4) of gel_starts, and the prior's mean, those that the patches' rows, and extra ones, speak for most."""
    settings = settings or GelSearchSettings()
    rows = patch_rows(patches, settings.rows)
    if extra is not None:
        rows = tables.stack(rows, extra)
    starts = gel_starts(model, patches, rng, settings)
    if prior is not None:
        widest = settings.modes.widest_angle, settings.modes.widest_share * model.radius
        starts = np.concatenate([starts_of_prior(model, prior, settings.drawn, *widest, rng), starts])
    blur, blur_normal = settings.rank_blur
    rough = AlignSettings(blur=blur * model.radius, blur_normal=blur_normal)
    few = rows.take(np.arange(0, len(rows), settings.ranking_step)).reweighted(settings.ranking_step)
    return starts[np.argsort(costs(model, few, starts, prior, rough), kind="stable")[: settings.ranked]]


def off_middle(model: ObjectModel, points: Array, poses: Array, share: float) -> Array:
    """(b,) nats against poses (b, 4, 4) for how far the mean of the contacts (n, 3) is from the object's centroid."""
    middles = poses[:, :3, :3] @ model.centroid + poses[:, :3, 3]
    away = np.linalg.norm(middles - points.mean(axis=0), axis=1)
    return np.asarray(0.5 * np.square(away / (share * model.radius)))


def localize_gels(
    model: ObjectModel,
    patches: Sequence[Patch],
    seed: int = 0,
    prior: Prior | None = None,
    extra: Evidence | None = None,
    settings: GelSearchSettings | None = None,
    sure_within: float | None = None,
) -> Localization:
    """The object from patches in one frame, anywhere; the answer is frame_from_object.

    prior: a Gaussian on the pose; extra: more rows in the same frame. sure_within (m): the confidence, by the modes'
    weights and covariances, is the probability that ADD-S is below; default 5 mm. Raises InputError when no gel touches
    anything.
    """
    settings = settings or GelSearchSettings()
    contacts = gel_contacts(patches, settings.rows)
    if not len(contacts):
        raise InputError("gels: expected at least one gel that touches something, got none")
    model.field  # noqa: B018  (built once per object, not part of the search's time, nor are the tables)
    build_tables(model, settings)
    begin = time.perf_counter()
    rng = np.random.default_rng(seed)
    rows = patch_rows(patches, settings.rows)
    if extra is not None:
        rows = tables.stack(rows, extra)
    starts = sifted_starts(model, patches, rng, prior, extra, settings)
    stages = tuple(SearchStage(b * model.radius, angle, 10**9, steps, n) for b, angle, steps, n in settings.passes)
    found = search(model, rows, starts, stages, prior)
    quiet = silent_rows(patches, settings.rows)
    quiet = quiet if extra is None else tables.stack(quiet, extra)
    middle = (contacts.points.mean(axis=0), settings.middle * model.radius) if len(contacts) > 1 else None
    result = fit_shapes(model, Shapes(patches, settings.shapes), found.poses, quiet, prior, middle)
    # how sure that is, the rows say, whose weights are measured: minima of a rough surface look sharper than they are
    wide = hessians_at(model, rows.reweighted(settings.belief), result.poses, prior, middle)
    modes = distinct_modes(model, replace(result, hessians=wide), settings.modes)
    pose = modes[0].pose
    sigma = float(np.sqrt(np.mean(contacts.sigma_point**2)))
    seconds = time.perf_counter() - begin
    answer = Localization(
        pose, modes, contact_index(model, contacts, pose), sigma, verdict_of(modes, model), seconds, "gels"
    )
    return judged(model, answer, draws_of(model, modes, rng), asked(settings.verdict, sure_within, model))
