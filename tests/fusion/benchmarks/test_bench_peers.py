"""The benchmark of peers: its views, its methods on one of them, and rows of what is not installed."""

import numpy as np
import pytest

from fusion.benchmarks.contacts import trials as contact_trials
from fusion.benchmarks.families.table import FAMILIES
from fusion.benchmarks.peers import arrays as peers_arrays
from fusion.benchmarks.peers import bench as peers
from fusion.benchmarks.peers import clouds as peers_clouds
from fusion.benchmarks.peers import contacts as peers_contacts
from fusion.benchmarks.peers import filters as peers_filters
from fusion.benchmarks.peers import local as peers_local
from fusion.benchmarks.peers import occlusion as peers_occlusion
from fusion.benchmarks.peers import pareto
from fusion.benchmarks.printing.tables import BenchSettings, Column, Table
from scenes.errors import InputError
from scenes.geometry import poses
from scenes.recordings.frames import Contacts
from scenes.synthesis import library


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


def smallest(chosen):
    return pareto.swept(list(chosen), quick=True)


def test_every_cloud_method_finds_an_easy_view_from_a_start(view):
    assert {"palpate", "FPFH + RANSAC + ICP", "FGR + ICP", "cv2.ppf_match_3d + ICP"} == {
        peer.name for peer in peers_clouds.peers(with_start=False)
    }
    local = smallest(peers_clouds.peers(with_start=True))
    assert {"palpate", "Open3D ICP", "Open3D GICP"} <= {peer.name for peer in local}
    points = peers_clouds.front(local, [view], 0, same, "")
    assert all(np.isfinite(point.error).all() and (point.ms > 0).all() for point in points)
    assert sum(bool(point.success[0]) for point in points) >= len(points) - 1
    assert 0 < peers_clouds.bound_mm([view]) < 0.5


def test_every_contact_method_runs_at_its_smallest_budget():
    chosen = {peer.name: peer for peer in smallest(peers_contacts.peers())}
    chosen.pop("chsel", None)
    del chosen["scipy dual_annealing"], chosen["scipy direct"]  # methods of localize as well, tested there
    done_on = peers_contacts.trials(1, 0)[:1]
    points = peers_contacts.front(list(chosen.values()), done_on, 0, same, "")
    assert [point.method for point in points] == ["palpate", "Monte-Carlo (T1)", "MUPF (T2)", "scipy basinhopping"]
    assert all(np.isfinite(point.error).all() for point in points)
    assert 0.05 < peers_contacts.bound_mm(done_on) < 5.0


def test_every_local_method_mends_the_start():
    done_on = peers_local.trials(4, 0)
    points = peers_contacts.front(smallest(peers_local.peers()), done_on, 0, same, "")
    assert len(points) == 7
    assert all(np.isfinite(point.error).all() for point in points)
    start = np.median([1e3 * contact_trials.errors(m, t.start, t.truth)[1] for m, t in done_on])
    assert points[0].place[1] < start
    told = peers_contacts.bound_mm(done_on, with_start=True)
    assert 0 < told < peers_contacts.bound_mm(done_on)  # the start is worth something


def test_array_searches_and_ours_are_compared_on_the_same_recordings():
    held = peers_arrays.cases(1, 0)[:1]
    chosen = smallest(peers_arrays.peers())
    assert chosen[0].name == "rows, then pressures (ours)"
    assert len(chosen) == 7
    points = pareto.measure(chosen[:2], held, lambda case: case.grasp, peers_arrays.judged, 0, same, "")
    assert all(np.isfinite(point.error).all() for point in points)


def test_filters_are_judged_above_the_least_that_any_reached():
    model = library.make("box")
    contacts = Contacts(model.sample_surface(12, seed=0)[0])
    sets = [peers_filters.Case("box", model, contacts, trial) for trial in range(2)]
    chosen = smallest(peers_filters.peers())
    assert len(chosen) == 7
    points = peers_filters.front([chosen[0], chosen[1], chosen[-1]], sets, 0, same, "")
    assert min(point.error.min() for point in points) == peers_filters.LEAST
    assert all((point.error >= peers_filters.LEAST).all() for point in points)


def test_senses_and_icp_on_a_frame():
    frames = peers_occlusion.cases(FAMILIES["clean"], 1, 0, quick=True)[:1]
    chosen = [peer for peer in smallest(peers_occlusion.peers()) if peer.name in ("fused", "ICP with contacts")]
    points = peers_occlusion.front(chosen, frames, 0, same, "")
    assert len(points) == 2
    assert 0 < peers_occlusion.bound_mm(frames) < points[0].error[0] < 10.0


def test_basinhopping_keeps_to_its_evaluations():
    used = []

    def cost(x):
        used.append(1)
        return float(np.sum((x - 0.3) ** 2))

    from touch.published.optimisers.direct import BoxSettings

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


def test_objects_that_are_asked_for_are_the_only_ones():
    shown = peers_occlusion.cases(FAMILIES["clean"], 1, 0, asked=("mug",))
    assert {case.model.name for case in shown} == {"mug"}


def test_objects_that_no_family_has_are_refused():
    with pytest.raises(InputError, match="objects: expected some of the families' objects, got sofa"):
        peers.run(BenchSettings(objects=("sofa",), family="clean"))
