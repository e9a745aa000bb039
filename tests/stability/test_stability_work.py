"""A guard against slow answers that no clock decides: rows that the compiled kernels evaluate for fixed inputs.

Counted, not timed: the same on every machine. Limits are a quarter above what was counted when they were written; an
answer that needs more has become slower, whatever the machine says.
"""

from dataclasses import replace

import numpy as np
import pytest
from cases.values import view

from fusion import estimate
from scenes.evidence import kernels, solver_kernels
from scenes.evidence.table import COLUMNS
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library
from touch.localization import localize
from touch.recognition import identify


class Work:
    """rows x (poses looked at + steps tried) of every call of the kernels."""

    def __init__(self, monkeypatch):
        self.rows = 0
        for module, name in ((solver_kernels, "align_poses"), (kernels, "cost_poses")):
            monkeypatch.setattr(module, name, self._counting(getattr(module, name)))

    def _counting(self, kernel):
        def counted(*arguments):
            kernel(*arguments)
            rows = next(a for a in arguments if isinstance(a, np.ndarray) and a.ndim == 2 and a.shape[1] == COLUMNS)
            last = arguments[-1]
            tried = int(last.sum()) if last.dtype == np.int64 else 0
            self.rows += len(rows) * (len(last) + tried)

        return counted


@pytest.fixture
def work(monkeypatch):
    return Work(monkeypatch)


@pytest.fixture(scope="module")
def block():
    return library.make("l_block")


def contacts(model, count, normals=True):
    points, directions = model.sample_surface(count, seed=3)
    return Contacts(points, directions if normals else None, 1e-3, 0.1)


@pytest.mark.parametrize(
    ("count", "normals", "limit"),
    [(5, True, 151_000), (25, True, 332_000), (200, True, 851_000), (8, False, 494_000), (100, False, 1_395_000)],
)
def test_touch_looks_at_no_more_rows(work, block, count, normals, limit):
    localize(block, contacts(block, count, normals), seed=0)
    assert 0 < work.rows <= limit


def test_rows_do_not_grow_with_contacts_beyond_measure(work, block):
    localize(block, contacts(block, 50), seed=0)
    few, work.rows = work.rows, 0
    localize(block, contacts(block, 500), seed=0)
    assert work.rows < 10 * few  # ten times the contacts, less than that in work


def test_an_estimate_by_touch_looks_at_no_more_rows(work, block):
    estimate(Frame(0, contacts=contacts(block, 8)), block)
    assert 0 < work.rows <= 931_000


@pytest.mark.parametrize(("with_start", "limit"), [(True, 947_000), (False, 698_000)])
def test_an_estimate_by_vision_looks_at_no_more_rows(work, with_start, limit):
    frame = view() if with_start else replace(view(), prior=None)
    estimate(frame, library.make("drill"))
    assert 0 < work.rows <= limit


def test_identification_looks_at_no_more_rows(work, block):
    identify([library.make("box"), block, library.make("cylinder")], contacts(block, 25), seed=0)
    assert 0 < work.rows <= 1_530_000
