"""A grasp as the icub-handover recordings hold it: cloud.off, contacts.off and model.off in the hand's frame, metres.

Vezzani et al., A novel pipeline for bi-manual handover task, Advanced Robotics 2017: a stereo cloud of the object after
the authors' filters, three fingertip contacts without normals, a simplified mesh; no camera and no ground truth.
"""

from __future__ import annotations

from pathlib import Path

from scenes.errors import CaptureError
from scenes.files.formats.off import read_off, write_off
from scenes.formats.conversion import Converted, many_contacts
from scenes.geometry.objects import ObjectModel
from scenes.recordings.captures import Capture, write_capture
from scenes.recordings.frames import Contacts, Frame

FILES = ("cloud.off", "contacts.off", "model.off")


def is_grasp(folder: str | Path) -> bool:
    """True when the folder holds the three files of a grasp."""
    return all((Path(folder) / name).is_file() for name in FILES)


def read_grasp(folder: str | Path) -> tuple[Frame, ObjectModel]:
    """The frame (cloud and contacts; the world is the hand) and the object, named like the folder.

    Raises CaptureError for a missing file, MeshError for one that is not OFF or an object that is not closed.
    """
    folder = Path(folder)
    for name in FILES:
        if not (folder / name).is_file():
            raise CaptureError(f"{folder}: expected {', '.join(FILES)}, missing {name}")
    cloud, felt = read_off(folder / "cloud.off"), read_off(folder / "contacts.off")
    model = ObjectModel.load(folder / "model.off", name=folder.resolve().name)
    frame = Frame(
        index=0,
        where=str(folder),
        cloud=cloud.points,
        cloud_colours=cloud.colours,
        contacts=Contacts(felt.points, felt.normals),
    )
    return frame, model


def convert(folder: str | Path, out: str | Path) -> Converted:
    """Write the grasp as a capture of one frame (world: the robot's hand); warns of contacts that are the cloud."""
    frame, model = read_grasp(folder)
    written = write_capture(out, [frame], model, world="robot base", notes={"source": "icub-handover"})
    return Converted((written,), 1, remarks=many_contacts(f"{Path(folder) / 'contacts.off'}", len(frame.contacts)))


def export(capture: Capture, out: str | Path) -> list[Path]:
    """The way back: each frame with a cloud as a folder of three OFF files, in the world's frame; returns the folders.

    Raises CaptureError when no frame has a cloud.
    """
    out, folders = Path(out), []
    clouds = [frame for frame in capture if frame.cloud is not None]
    for frame in clouds:
        if frame.cloud is None:
            continue
        folder = out if len(clouds) == 1 else out / f"{frame.index:06d}"
        folder.mkdir(parents=True, exist_ok=True)
        write_off(folder / "cloud.off", frame.cloud, colours=frame.cloud_colours)
        normals = frame.contacts.normals if frame.contacts.has_normal.all() and len(frame.contacts) else None
        write_off(folder / "contacts.off", frame.contacts.points, normals=normals)
        write_off(folder / "model.off", capture.model.vertices, capture.model.faces)
        folders.append(folder)
    if not folders:
        message = "expected a frame with a cloud to write as OFF, found none: --to chooses another format"
        raise CaptureError(f"{capture.path}: {message}")
    return folders
