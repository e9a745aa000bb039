"""The benchmark of peers: its views, its methods on one of them, and rows of what is not installed."""

import numpy as np
import pytest

from fusion.benchmarks import peers, peers_clouds, peers_contacts
from fusion.benchmarks.tables import BenchSettings, Column, Table
from scenes import poses


@pytest.fixture(scope="module")
def view():
    views = peers_clouds.views(1, 0)
    next(views)
    return next(views)  # 30 % hidden


def same(items, total, what):
    return items


def test_a_view_is_the_objects_pixels_less_what_is_hidden(view):
    truth, mask = view.frame.camera_from_object_truth, view.frame.mask
    assert mask.sum() == len(view.points) == (view.frame.depth > 0).sum()
    distance = view.model.field.distance(poses.apply(poses.inverse(truth), view.points))
    assert np.median(np.abs(distance)) < 2e-3
    whole = next(peers_clouds.views(1, 0))
    assert len(whole.points) > 100


def test_every_cloud_method_finds_an_easy_view_from_a_start(view):
    chosen = {(p.method, p.with_start): p for p in peers_clouds.peers(False)}
    assert {"palpate", "Open3D ICP", "Open3D GICP"} <= {method for method, start in chosen if start}
    assert {"palpate", "FPFH + RANSAC + ICP", "FGR + ICP", "cv2.ppf_match_3d + ICP"} <= {
        method for method, start in chosen if not start
    }
    local = [peer for (_, start), peer in chosen.items() if start]
    points = peers_clouds.measure(local, [view], 0, same)
    assert all(np.isfinite(point.error).all() and (point.ms > 0).all() for point in points)
    assert sum(bool(point.success[0]) for point in points) >= len(points) - 1
    bound = peers_clouds.bound_mm([view])
    assert 0 < bound < min(float(point.error[0]) for point in points)


def test_every_contact_method_runs_at_its_smallest_budget():
    first = {}
    for peer in peers_contacts.peers(False):
        first.setdefault(peer.method, peer)
    del first["scipy dual_annealing"], first["scipy direct"]  # methods of localize as well, tested there
    first.pop("chsel", None)
    done_on = peers_contacts.trials(1, 0)[:1]
    points = peers_contacts.measure(list(first.values()), done_on, 0, same)
    assert [point.method for point in points] == ["palpate", "scipy basinhopping"]
    assert all(np.isfinite(point.error).all() for point in points)
    assert 0.05 < peers_contacts.bound_mm(done_on) < 5.0


def test_basinhopping_keeps_to_its_evaluations():
    used = []

    def cost(x):
        used.append(1)
        return float(np.sum((x - 0.3) ** 2))

    from touch.searches.direct import BoxSettings

    best = peers_contacts._basinhopping(cost, [(-1.0, 1.0)] * 6, 0, BoxSettings(evaluations=150))
    assert len(used) == 150
    assert np.abs(best - 0.3).max() < 1e-3


def test_what_is_not_installed_is_a_row(monkeypatch):
    monkeypatch.setattr(peers_contacts, "find_spec", lambda name: None)
    missing = peers_contacts.missing()
    assert "not installed" in missing["chsel"]
    table = Table("t", [Column(str(i)) for i in range(9)])
    peers._absent(table, "chsel", missing["chsel"])
    assert table.texts()[0][:3] == ["chsel", missing["chsel"], "–"]
    assert BenchSettings(quick=True).count(4, quick=1) == 1
