"""What several test files share: settings of property tests, data that may be absent, frames slow to make."""

import numpy as np
import pytest
from hypothesis import settings
from shared_data import DATA

from scenes.synthesis import library

# Compiled kernels take seconds at their first call, so an example has no deadline. The same examples every time: a run
# says what changed. `--hypothesis-profile explore` draws others.
settings.register_profile("palpate", deadline=None, max_examples=40, derandomize=True)
settings.register_profile("explore", deadline=None, max_examples=400)
settings.load_profile("palpate")


@pytest.fixture(scope="session")
def contact_data():
    """Folder of the real and simulated iCub contacts."""
    folder = DATA / "icub-contacts"
    if not folder.is_dir():
        pytest.skip(f"no contact sets at {folder} (set PALPATE_DATA to where they are)")
    return folder


@pytest.fixture(scope="session")
def hand():
    from scenes.synthesis.hands import five_finger_hand

    return five_finger_hand()


@pytest.fixture(scope="session")
def drill():
    return library.make("drill")


@pytest.fixture(scope="session")
def lab_frame(hand, drill):
    """One frame of a drill, 60 % hidden by the hand, with every error of the preset."""
    from scenes.synthesis.recording import SynthesisSettings, synthesize_frames

    return synthesize_frames(drill, hand, occlusion=0.6, noise="lab", seed=5, settings=SynthesisSettings(mask=True))[0]


@pytest.fixture(scope="session")
def exact_frame(hand, drill):
    """The same grasp without any error."""
    from scenes.synthesis.noise.presets import PRESETS
    from scenes.synthesis.recording import SynthesisSettings, synthesize_frames

    return synthesize_frames(
        drill, hand, occlusion=0.6, noise=PRESETS["none"], seed=5, settings=SynthesisSettings(mask=True)
    )[0]


@pytest.fixture
def rng():
    return np.random.default_rng(7)
