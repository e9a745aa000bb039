"""The same frame and seed give the same bits, in one process and in two, whatever the number of threads."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from fusion import estimate

PROGRAM = """
import hashlib
import numpy as np
from fusion import estimate
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.recording import SynthesisSettings, synthesize_frames

model = library.make("drill")
frame = synthesize_frames(model, five_finger_hand(), occlusion=0.6, noise="lab", seed=5,
                          settings=SynthesisSettings(rgb=False))[0]
answer = estimate(frame, model, seed=3)
state = [answer.pose, answer.covariance] + [m.pose for m in answer.modes] + [np.array([m.weight for m in answer.modes])]
print(hashlib.sha256(frame.depth.tobytes()).hexdigest())
print(hashlib.sha256(b"".join(x.tobytes() for x in state)).hexdigest(), answer.verdict)
"""


def test_an_estimate_is_the_same_in_two_processes_with_other_threads():
    root = Path(__file__).resolve().parents[2]
    running = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM],
            cwd=root,
            env={**os.environ, "PYTHONPATH": str(root), "PALPATE_THREADS": threads},
            stdout=subprocess.PIPE,
            text=True,
        )
        for threads in ("1", "2")
    ]
    outputs = [process.communicate(timeout=300)[0] for process in running]
    assert all(process.returncode == 0 for process in running)
    assert outputs[0] == outputs[1]
    assert len(outputs[0].split()[1]) == 64


def test_an_estimate_repeats_and_leaves_its_input_alone(lab_frame, drill):
    depth, prior = lab_frame.depth.copy(), lab_frame.prior.copy()
    points = lab_frame.contacts.points.copy()
    first, second = estimate(lab_frame, drill, seed=1), estimate(lab_frame, drill, seed=1)
    assert np.array_equal(first.pose, second.pose)
    assert np.array_equal(first.covariance, second.covariance)
    assert [s.name for s in first.trace] == [s.name for s in second.trace]
    assert np.array_equal(lab_frame.depth, depth)
    assert np.array_equal(lab_frame.prior, prior)
    assert np.array_equal(lab_frame.contacts.points, points)


def test_an_estimate_is_the_same_in_whatever_thread_it_is_made(lab_frame, drill):
    here = estimate(lab_frame, drill, seed=1)
    with ThreadPoolExecutor(2) as pool:
        others = [asked.result(60.0) for asked in [pool.submit(estimate, lab_frame, drill, seed=1) for _ in range(3)]]
    for other in others:
        assert np.array_equal(other.pose, here.pose)
        assert np.array_equal(other.covariance, here.covariance)
        assert other.confidence == here.confidence
