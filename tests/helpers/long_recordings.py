"""Recordings of many small frames from few that are made: an object in a hand goes there and back again."""

from dataclasses import replace

from scenes.geometry.cameras import Camera
from scenes.recordings.captures import write_capture
from scenes.synthesis import library
from scenes.synthesis.recording import SynthesisSettings, synthesize_frames

# A quarter of VGA a side.
SMALL = Camera(142.5, 142.5, 79.5, 59.5, 160, 120)


def there_and_back(folder, hand, count, made=8, name="drill", rgb=False, motion="carry"):
    """Write a capture of `count` frames, of which `made` differ, and return its folder."""
    model = library.make(name)
    settings = SynthesisSettings(rgb=rgb, camera=SMALL)
    few = synthesize_frames(model, hand, made, 0.4, noise="lab", seed=7, motion=motion, settings=settings)
    around = [*few, *few[-2:0:-1]]

    def frames():
        for index in range(count):
            yield replace(around[index % len(around)], index=index, prior=few[0].prior if index == 0 else None)

    return write_capture(folder, frames(), model, hand)
