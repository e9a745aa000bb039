"""A search's modes made an answer's: shared errors solved for, covariances sampled, picture, outline and twins asked.

The step between the search and the verdict. Camera frame, metres, radians.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Mode
from fusion.estimation.posterior.moments import moments
from fusion.estimation.posterior.tolerance import is_within, with_shared_errors
from fusion.estimation.posterior.turns import by_turns
from fusion.estimation.ranking import led, rejudged
from fusion.estimation.search.modes import not_solved, worth_solving
from fusion.estimation.solve.joint import parted
from fusion.estimation.solve.outlined import asks_for, outlined
from fusion.estimation.steps.facing import Faced, Facing, by_print, turned_as_printed, unread
from fusion.estimation.steps.fingers import with_fingers
from fusion.estimation.steps.picture import asked_picture, why_not_asked
from fusion.estimation.steps.sense import solve_together
from fusion.estimation.steps.twins import with_twins
from fusion.estimation.trace import Trace
from scenes.evidence import table as tables
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from touch.contacts import Felt

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Finished:
    """An answer's modes, likeliest first, and the evidence as it holds there. seen: vision's rows, rows: all of them;
    felt: touch under the calibration that was solved for. searched (4, 4): where the search ended; seen_from (4, 4):
    takes a pose to where the depth image, as it is, shows the object; beside (m): by how much the outline in the image
    is off beyond what was solved for; facing: what the print says; useless: why colours are not used, in words; here
    and elsewhere (4, 4): where depth shows the object, and where the image does when that is elsewhere, else None.
    """

    modes: tuple[Mode, ...]
    seen: Evidence
    rows: Evidence
    felt: Felt
    searched: Array
    seen_from: Array
    beside: float
    facing: Facing
    useless: tuple[str, ...]
    here: Array
    elsewhere: Array | None


def finished(found: Faced, trace: Trace) -> Finished | None:
    """The modes with all that is known of shared errors; None when the caller wants an answer within the tolerance or
    none, and the rows alone give none.
    """
    asked, sensed, facing = found.asked, found.sensed, found.facing
    settings, beliefs, believed = asked.settings, asked.beliefs, asked.prior
    pool, predictor, model = sensed.pool, sensed.pool.predictor, sensed.pool.model
    viewed, felt, seen, rows = sensed.viewed, sensed.felt, sensed.seen, sensed.rows
    modes = found.found.modes
    spent, rough = trace.over_budget, modes
    if spent or asked.tolerance is not None:
        rough = with_shared_errors(model, modes, viewed, beliefs.depth)
    settled = is_within(model, rough, asked.tolerance, settings)
    if asked.or_none and not settled:
        return None  # before anything is solved for that touch will change
    why_not = "the time budget is spent" if spent else "the rows alone are within the tolerance"
    finish = not (spent or settled)
    modes = modes if finish else rough
    searched = modes[0].pose
    seen_from = np.eye(4)
    with trace.stage("solve together", finish, why_not) as stage:
        if finish:
            weights = settings.told if predictor.sees else settings.felt
            worth = worth_solving(found.found, settings.plan, settings.joint.modes, weights)
            solved = solve_together(sensed, worth, asked)
            in_all = solved.costs - by_print(found.gains, len(worth))
            # where a print was read, the modes were asked about it
            rest = () if facing.pixels else not_solved(found.found, worth, float(in_all[0]))
            modes = rejudged(model, solved.results, in_all, settings, predictor.sees, rest)
            modes, first_of = led(modes, solved.results)
            searched = worth[first_of]
            best, seen = parted(solved.results[first_of]), solved.shown[first_of]
            seen_from = best.as_seen @ se3.inverse(best.pose)
            rows = tables.stack(seen, felt.rows)
            felt = felt.corrected(best.correct())
            off = f"calibration off by {best.millimetres:.1f} mm, depth scale by {100 * best.scale:+.2f} %"
            stage.note(len(rows), off)
    with trace.stage("sample", finish, why_not) as stage:
        if finish:
            first, how_wide = modes[0], settings.moments
            spread = moments(model, rows, first.pose, first.covariance, asked.seed, believed, settings=how_wide)
            how = spread.covariance, settings.told.temper, predictor.side, settings.turns
            more = by_turns(pool, spread.pose, seen_from @ spread.pose, *how).covariance
            modes = (replace(first, pose=spread.pose, covariance=spread.covariance + more), *modes[1:])
            modes = tuple(with_fingers(model, felt, mode, believed) for mode in modes)
            stage.note(len(rows), f"{spread.effective:.0f} effective samples, directions widened: {spread.widened}")
    unasked = why_not_asked(model, modes[0], predictor, settings.picture_mean)
    with trace.stage("picture", finish and not unasked, why_not if not finish else unasked) as stage:
        if finish and not unasked:
            first, why = asked_picture(model, modes[0], seen_from, predictor, asked.seed, settings.picture_mean)
            modes = (first, *modes[1:])
            stage.note(len(rows), why)
    coloured = viewed.rgb is not None and predictor.sees and asks_for(viewed.rgb, beliefs, settings.contour)
    no_image = "no image beside depth" if viewed.rgb is None else "an image beside depth's own is not asked for"
    useless: tuple[str, ...] = ()
    beside, elsewhere, here = 0.0, None, modes[0].pose
    with trace.stage("outline", finish and coloured, why_not if coloured else no_image) as stage:
        if finish and coloured:
            told = outlined(viewed, pool, best, modes[0], beliefs, settings)
            modes, felt = (told.mode, *modes[1:]), felt.corrected(told.solved.correct())
            beside, elsewhere, here = told.beside, told.elsewhere, best.as_seen
            useless = () if told.lines else (f"colours are not used: {told.why}",)
            stage.note(told.lines, told.why)
    first, facing = turned_as_printed(sensed, modes[0], facing, settings.texture)
    modes = (first, *modes[1:])
    if finish and not facing.pixels:
        # where a print is read, it has asked about every way round
        by_picture = (predictor.costs, predictor.rough_costs) if predictor.sees else (None, None)
        modes = with_twins(model, modes, rows, believed, settings, *by_picture)
    notes = *useless, *unread(facing)
    return Finished(modes, seen, rows, felt, searched, seen_from, beside, facing, notes, here, elsewhere)
