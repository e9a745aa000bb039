"""Which object was touched: right when the data tell, never sure of the wrong one when they do not."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.cli.main import main
from scenes.errors import InputError
from scenes.evidence import table as tables
from scenes.files.formats.off import write_off
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from touch.published.particles.recursion import StoppingRule, localize_online
from touch.recognition import identify

NAMES = ("l_block", "box", "cylinder", "pencil")


@pytest.fixture(scope="module")
def models():
    return [library.make(name) for name in NAMES]


def touched(model, count, noise, seed, outliers=0.0, normals=False):
    rng = np.random.default_rng(seed)
    points, directions = model.sample_surface(count, seed=seed)
    points = points + noise * rng.normal(size=points.shape)
    false = rng.random(count) < outliers
    points = points + np.where(false[:, None], 0.03 * np.abs(rng.normal(size=(count, 1))) * directions, 0.0)
    pose = poses.make_pose(poses.random_rotations(1, rng)[0], 0.3 * rng.normal(size=3))
    directions = directions @ pose[:3, :3].T if normals else None
    return Contacts(poses.apply(pose, points), directions), pose


@pytest.mark.parametrize("name", NAMES)
def test_clean_contacts_are_named(models, name):
    contacts, _ = touched(library.make(name), 40, 0.0, seed=3)
    found = identify(models, contacts, seed=0)
    assert (found.best, found.verdict, found.notes) == (name, "ok", ())
    assert found.candidates[0].index < 5e-4
    assert found.margin > 3
    # what a lattice leaves over of exact contacts is alike among neighbours, and no misfit
    assert found.independent > 20


def test_hardly_ever_sure_of_the_wrong_one(models, rng):
    """Sure means 99 %: of 30 draws, with up to 30 % false contacts, two sure and wrong would be a chance of 4 %."""
    wrong = []
    for seed in range(30):
        name, outliers, count = rng.choice(NAMES), float(rng.choice([0.0, 0.1, 0.3])), int(rng.integers(3, 61))
        contacts, _ = touched(library.make(name), count, 0.001, seed, outliers)
        found = identify(models, contacts, seed=seed)
        if found.verdict == "ok" and found.best != name:
            wrong.append((seed, name, outliers, count, found.best))
    assert len(wrong) <= 1, wrong


@given(st.integers(0, 10_000))
@settings(max_examples=4)
def test_shares_sum_to_one_and_order_is_by_likelihood(models, seed):
    contacts, _ = touched(models[0], 12, 0.002, seed)
    found = identify(models, contacts, seed=seed)
    likelihoods = [one.likelihood for one in found.candidates]
    assert sum(likelihoods) + found.none == pytest.approx(1.0)
    assert likelihoods == sorted(likelihoods, reverse=True)
    assert sum(one.inverse_cost for one in found.candidates) == pytest.approx(1.0)
    assert {one.name for one in found.candidates} == set(NAMES)
    assert found.best == found.candidates[0].name


def bent(model, size, seed):
    """Another object of the same kind: the model with a smooth field of `size` (m) on its surface."""
    from trimesh.remesh import subdivide_to_size

    rng = np.random.default_rng(seed)
    vertices, faces = subdivide_to_size(model.vertices, model.faces, 0.06 * model.diameter)
    waves = 2 * np.pi / model.diameter * rng.normal(size=(3, 3))
    field = np.cos(vertices @ waves.T + rng.uniform(0, 2 * np.pi, size=3)) * np.sqrt(2.0)
    return ObjectModel.from_mesh(vertices + size * field, faces, "bent")


@pytest.mark.parametrize("name", ["l_block", "cylinder"])
@pytest.mark.parametrize("seed", range(3))
def test_a_relative_of_the_only_candidate_is_none_of_these(name, seed):
    """One candidate, and 80 contacts of 0.5 mm on something that is 3 mm otherwise: never ok."""
    model = library.make(name)
    stranger = identify([model], touched(bent(model, 0.003, seed), 80, 0.0005, seed)[0], seed=seed)
    assert stranger.verdict != "ok"
    assert stranger.none > 0.5  # 0.05 before anything was felt
    itself = identify([model], touched(model, 80, 0.0005, seed)[0], seed=seed)
    assert itself.verdict == "ok"
    assert itself.none < 0.01


@pytest.mark.parametrize("count", [1, 3, 8])
def test_a_few_contacts_do_not_tell_that_it_is_the_only_candidate(models, count):
    """A pose fits six numbers: nothing but one candidate is no evidence for it."""
    contacts, _ = touched(models[0], count, 0.0, seed=count)
    assert identify(models[:1], contacts).verdict == "ambiguous"


def test_a_tool_of_the_same_family_is_not_the_tool(contact_data):
    """Recorded contacts without their tool among the candidates: no relative is named for sure."""
    from fusion.benchmarks.contacts.sets import recognition_models, recognition_sets

    tools = recognition_models()
    for name, contacts in recognition_sets().items():
        truth = "pipeHook2" if name == "hook2" else name.rpartition("_")[2]
        others = identify([tool for tool in tools if tool.name != truth], contacts)
        assert others.verdict != "ok"
        assert others.none > 0.99
        alone = identify([next(tool for tool in tools if tool.name == others.best)], contacts)
        assert alone.verdict != "ok"


@pytest.mark.parametrize(("count", "noise"), [(20, 0.001), (30, 0.0005)])
def test_a_tool_that_is_off_by_less_than_a_millimetre_is_not_named_for_want_of_it(contact_data, count, noise):
    """Two hooks differ by 0.9 mm: 20 or 30 noisy contacts on one do not tell that they are not on the other."""
    from fusion.benchmarks.contacts.recognition import _touched
    from fusion.benchmarks.contacts.sets import recognition_models

    tools = recognition_models()
    hook = next(k for k, tool in enumerate(tools) if tool.name == "pipeHook2")
    rng = np.random.default_rng([11, count, int(1e4 * noise), 0, hook, 0, 1])
    felt = _touched(tools[hook], count, noise, rng)
    assert identify([tool for tool in tools if tool is not tools[hook]], felt, 11).verdict != "ok"


def test_a_fifth_of_false_contacts_hides_no_tool(contact_data):
    """The right pose may be far down after the first pass: of this tool a relative's was taken."""
    from fusion.benchmarks.contacts.recognition import _touched
    from fusion.benchmarks.contacts.sets import recognition_models

    tools = recognition_models()
    felt = _touched(tools[2], 100, 0.001, np.random.default_rng([11, 100, 10, 20, 2, 0, 1]), 0.2)
    found = identify(tools, felt, 11)
    assert (found.best, found.verdict) == (tools[2].name, "ok")


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_few_contacts_cannot_tell(models, count):
    contacts, _ = touched(models[1], count, 0.0, seed=count)
    found = identify(models, contacts)
    assert found.verdict == "ambiguous"
    assert any("independent contacts, of 12 that a name takes" in note for note in found.notes)


def test_a_plane_cannot_tell_blocks_apart(models):
    rng = np.random.default_rng(0)
    plane = np.column_stack([rng.uniform(-0.01, 0.01, size=(30, 2)), np.zeros(30)])
    assert identify(models[:2], Contacts(plane)).verdict == "ambiguous"


def test_one_contact_felt_often_is_one_contact(models):
    once, _ = touched(models[0], 1, 0.0, seed=1)
    assert identify(models, Contacts(np.repeat(once.points, 30, axis=0))).verdict == "ambiguous"


def test_nothing_that_fits_is_lost(models):
    points = 0.4 * np.random.default_rng(0).normal(size=(60, 3))
    assert identify(models, Contacts(points)).verdict == "lost"


def test_same_seed_same_bits(models):
    contacts, _ = touched(models[2], 20, 0.002, seed=2)
    first, second = identify(models, contacts, seed=5), identify(models, contacts, seed=5)
    for a, b in zip(first.candidates, second.candidates):
        assert (a.name, a.index, a.likelihood) == (b.name, b.index, b.likelihood)
        np.testing.assert_array_equal(a.pose, b.pose)


def test_normals_and_empty_space_are_used(models):
    """Contacts on two parallel planes fit both blocks; where the box would stick out, nothing was felt."""
    block, box = models[0], models[1]
    contacts, pose = touched(block, 10, 0.0, seed=8, normals=True)
    plain = identify([block, box], Contacts(contacts.points))
    empty = poses.apply(pose, block.centroid + np.array([[0.04, 0.03, 0.0]]))
    assert block.field.distance(poses.apply(poses.inverse(pose), empty))[0] > 0.005
    extra = tables.outside(empty, 0.001, tables.TOUCH)
    told = identify([block, box], contacts, extra=extra)
    share = {one.name: one.likelihood for one in told.candidates}["l_block"]
    assert share >= {one.name: one.likelihood for one in plain.candidates}["l_block"]
    assert told.best == "l_block"


def test_bad_use_is_refused(models):
    contacts, _ = touched(models[0], 5, 0.0, seed=0)
    with pytest.raises(InputError, match="at least one contact"):
        identify(models, Contacts(np.zeros((0, 3))))
    with pytest.raises(InputError, match="got none"):
        identify([], contacts)
    with pytest.raises(InputError, match="different names"):
        identify([models[0], models[0]], contacts)


def test_the_command(models, tmp_path, capsys):
    folder = tmp_path / "objects"
    folder.mkdir()
    for model in models[:2]:
        write_off(folder / f"{model.name}.off", model.vertices, model.faces)
    contacts, _ = touched(models[1], 30, 0.0, seed=6)
    write_off(tmp_path / "contacts.off", contacts.points)
    argv = ["identify", str(tmp_path / "contacts.off"), "--objects", str(folder)]
    assert main([*argv, "--json", str(tmp_path / "i.json")]) == 0
    result = json.loads((tmp_path / "i.json").read_text())
    assert (result["best"], result["verdict"]) == ("box", "ok")
    assert {one["object"] for one in result["candidates"]} == {"l_block", "box"}
    assert "box: ok" in capsys.readouterr().out
    assert main(["identify", str(tmp_path / "contacts.off"), "--objects", str(tmp_path / "none")]) == 2
    assert main(["identify", str(tmp_path / "none.off"), "--objects", str(folder)]) == 2
    (tmp_path / "empty").mkdir()
    assert main(["identify", str(tmp_path / "contacts.off"), "--objects", str(tmp_path / "empty")]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 3
    assert "Traceback" not in "".join(errors)


def test_recorded_tools(contact_data):
    from fusion.benchmarks.contacts.sets import recognition_models, recognition_sets

    tools = recognition_models()
    assert len(tools) == 9
    for name, contacts in recognition_sets().items():
        truth = "pipeHook2" if name == "hook2" else name.rpartition("_")[2]
        found = identify(tools, contacts)
        assert (found.best, found.verdict) == (truth, "ok")


# ---- contact by contact ----


def test_the_rule_waits_for_a_flat_index():
    rule = StoppingRule()
    falling = [0.05 * 0.8**n for n in range(15)]
    assert not any(rule.observe(index) for index in falling[:14])
    rule = StoppingRule()
    settled = [rule.observe(index) for index in [0.05, 0.03, 0.02, *[0.005] * 20]]
    assert not any(settled[: rule.settings.fewest - 1])
    assert settled[-1]


def test_the_rule_does_not_stop_in_a_jump():
    rule = StoppingRule()
    assert not any(rule.observe(index) for index in [0.002, 0.02] * 12)


@pytest.mark.parametrize("method", ["mupf", "multistart"])
def test_an_estimate_after_every_contact(models, method):
    contacts, _ = touched(models[0], 6, 0.0, seed=1)
    steps = list(localize_online(models[0], contacts, seed=0, method=method))
    assert [step.contacts for step in steps] == [1, 2, 3, 4, 5, 6]
    assert all(np.isfinite(step.pose).all() and step.index >= 0 for step in steps)


def test_online_bad_use_is_refused(models):
    with pytest.raises(InputError, match="mupf or multistart"):
        next(localize_online(models[0], Contacts(np.zeros((1, 3))), method="guess"))
    with pytest.raises(InputError, match="at least one contact"):
        next(localize_online(models[0], Contacts(np.zeros((0, 3)))))
