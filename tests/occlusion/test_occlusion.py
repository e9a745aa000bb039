"""How often the estimate succeeds behind a hand that hides more and more: start 16 degrees and 33 mm off, lab noise.

Success: ADD-S below 5 mm. The full suite (five objects, four shares, ten grasps) takes minutes and is marked slow.
"""

import numpy as np
import pytest
from scipy.stats import binom, chi2

from fusion import estimate
from fusion.benchmarks.strata import freedom
from fusion.truth.errors import Judge, JudgeSettings
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.recording import SynthesisSettings, synthesize_frames

HIDDEN = (0.0, 0.3, 0.6, 0.8)
SUCCESS = JudgeSettings().success


def run(name, hidden, seeds):
    """Errors and verdicts of one object at one hidden share: a grasp, view and draw of noise each."""
    model, hand, settings = library.make(name), five_finger_hand(), SynthesisSettings(rgb=False)
    judge, results = Judge(model), []
    for seed in seeds:
        frame = synthesize_frames(model, hand, occlusion=hidden, noise="lab", seed=seed, settings=settings)[0]
        answer = estimate(frame, model, seed=seed)
        results.append((judge.errors(answer.pose, frame.camera_from_object_truth, answer.covariance), answer, frame))
    return results


def summary(results):
    add_s = np.array([e.add_s for e, *_ in results])
    nees = np.array([e.nees for e, *_ in results]) / 6.0
    share = float((add_s < SUCCESS).mean())
    print(
        f"{len(results)} frames: success {share:.0%}, median ADD-S {1e3 * np.median(add_s):.2f} mm,"
        f" median NEES/6 {np.median(nees):.2f}"
    )
    return share, float(np.median(add_s))


@pytest.fixture(scope="module")
def few():
    """Three objects, three hidden shares, three grasps."""
    return {
        (name, hidden): run(name, hidden, range(3)) for name in ("drill", "mug", "box") for hidden in (0.3, 0.6, 0.8)
    }


def pooled(few, hidden):
    return [result for (_, share), results in few.items() if share == hidden for result in results]


# Nine trials a level: a method that succeeds 98 % of the time passes 8 of 9 in 99 of 100 draws of trials. Measured: all
# of them; medians of 0.8, 0.8 and 1.2 mm.
@pytest.mark.parametrize(("hidden", "median"), [(0.3, 0.0015), (0.6, 0.0015), (0.8, 0.002)])
def test_most_frames_succeed_behind_the_hand(few, hidden, median):
    results = pooled(few, hidden)
    share, middle = summary(results)
    assert len(results) == 9
    assert share * 9 >= 8
    assert middle < median


def test_answers_are_as_wrong_as_they_say_behind_the_hand(few):
    """Coverage, NEES and confidence of the same frames, at each hidden share and together."""
    inside = []
    for hidden in (0.3, 0.6, 0.8):
        ratios, sure = [], []
        for (name, share), results in few.items():
            if share != hidden:
                continue
            dof = freedom(library.make(name).symmetries)
            ratios += [errors.nees / dof for errors, *_ in results]
            inside += [chi2.cdf(errors.nees, dof) <= 0.95 for errors, *_ in results]
            sure += [answer.confidence for _, answer, _ in results]
        # measured: 0.6, 0.3 and 0.5, wider than need be; nine right covariances are within 0.5 and 1.7
        assert 0.15 < np.mean(ratios) < 1.2
        # all are right, which is said with 0.91, 0.86 and 0.84
        assert np.mean(sure) > 0.7
    # measured: all 27; the fewest that regions which hold 95 % hold, but for once in a thousand
    assert sum(inside) >= int(binom.ppf(1e-3, len(inside), 0.95))


def test_every_answer_is_a_finite_pose_with_a_positive_covariance(few):
    for results in few.values():
        for _, answer, _ in results:
            assert np.isfinite(answer.pose).all()
            assert np.linalg.eigvalsh(answer.covariance).min() > 0
            assert answer.verdict in ("ok", "ambiguous", "lost")
            assert sum(m.weight for m in answer.modes) == pytest.approx(1.0)


def test_fused_is_no_worse_than_vision_alone_where_most_is_hidden(few):
    """At 80 % hidden, on the same frames with touch left out: nine frames, so the medians get a quarter of room."""
    both, alone = [], []
    for name in sorted({name for name, hidden in few if hidden == 0.8}):
        model = library.make(name)
        judge = Judge(model)
        for errors, _, frame in few[name, 0.8]:
            both.append(errors.add_s)
            pose = estimate(frame, model, use="vision").pose
            alone.append(judge.errors(pose, frame.camera_from_object_truth).add_s)
    assert np.mean(np.array(both) < 0.005) >= np.mean(np.array(alone) < 0.005)
    assert np.median(both) < 1.25 * np.median(alone)


@pytest.mark.slow
@pytest.mark.parametrize("hidden", HIDDEN)
def test_the_whole_suite(hidden):
    results = [r for name in ("drill", "mug", "box", "bottle", "l_block") for r in run(name, hidden, range(10))]
    share, middle = summary(results)
    assert len(results) == 50
    # asked: 95 % at 60 % hidden and 90 % at 80 %; two binomial deviations of fifty trials are left as room
    assert share >= {0.0: 0.90, 0.3: 0.90, 0.6: 0.89, 0.8: 0.82}[hidden]
    assert middle < {0.0: 0.0025, 0.3: 0.0025, 0.6: 0.0025, 0.8: 0.0035}[hidden]
