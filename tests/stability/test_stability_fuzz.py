"""Random inputs: seeded ones from the common list, and hypothesis, which shrinks what it finds."""

import numpy as np
from cases import fuzz as stability_cases_fuzz
from cases.registry import is_covariance, is_rigid, is_sound
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from scenes.errors import PalpateError
from scenes.evidence.align import align, costs
from scenes.evidence.modes import covariance_of
from scenes.evidence.table import TOUCH, make
from scenes.geometry import poses as se3
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from touch.localization import localize

CASES = stability_cases_fuzz.CASES

LENGTHS = st.floats(-10.0, 10.0, width=64)
ANY = st.floats(allow_nan=True, allow_infinity=True, width=64)


def test_holds(case):
    case.run()


@settings(derandomize=True, deadline=None, max_examples=200)
@given(
    arrays(np.float64, st.tuples(st.integers(1, 6), st.just(3)), elements=LENGTHS),
    st.floats(1e-9, 1e3),
    arrays(np.float64, 3, elements=st.floats(-4.0, 4.0)),
    arrays(np.float64, 3, elements=LENGTHS),
)
def test_no_step_raises_the_cost(points, sigma, turn, move):
    model = library.make("box")
    rows = make(points, sigma, TOUCH)
    start = se3.make_pose(se3.exp_rotation(turn), move)[None]
    before = costs(model, rows, start)
    found = align(model, rows, start)
    assert (found.costs <= before).all()
    is_rigid(found.poses)
    is_covariance(covariance_of(model, found.hessians[0]))


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    arrays(np.float64, st.tuples(st.integers(0, 5), st.just(3)), elements=ANY),
    st.one_of(st.none(), ANY),
    st.booleans(),
)
def test_any_numbers_are_answered_or_refused(points, sigma, with_normals):
    model = library.make("box")
    try:
        contacts = Contacts(points, points if with_normals else None, sigma)
        found = localize(model, contacts)
    except PalpateError:
        return
    is_sound(found)
