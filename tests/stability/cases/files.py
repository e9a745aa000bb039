"""Every reader of files on damaged ones: no exception but ours, no hang, memory bounded.

A child process with a bound on its address space does the reading, so that neither a crash of a library nor a file
that claims 10^12 points reaches the caller. Damage is guided by coverage: an input that reaches a line of ours that no
other one reached is kept, and damaged further.
"""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from cases.registry import Cases, need, refuses
from scenes.errors import PalpateError
from scenes.files.formats.images import decode
from scenes.files.formats.off import read_off

CASES = Cases()

# What a child may use beyond what it holds when it begins (bytes), and how long one file may take (processor seconds).
MEMORY = 1 << 30
LONGEST = 3.0
# Files kept to be damaged further, for each reader.
KEPT = 60
OURS = (f"{os.sep}scenes{os.sep}", f"{os.sep}fusion{os.sep}", f"{os.sep}touch{os.sep}")

PROGRAM = """
import sys
from pathlib import Path
from cases.files import damage
damage(Path(sys.argv[1]), sys.argv[2].split("|"), int(sys.argv[3]), int(sys.argv[4]))
"""


# OFF files that lie, each in one way.
LYING_OFF = {
    "NaN": "OFF\n3 1 0\n0 0 nan\n1 0 0\n0 1 0\n3 0 1 2\n",
    "infinity": "OFF\n3 1 0\n0 0 0\n1e999 0 0\n0 1 0\n3 0 1 2\n",
    "a corner too many": "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n",
    "a point too many": "OFF\n4 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
    "10^12 points": "OFF\n1000000000000 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
}


@CASES("files", "", over=tuple(LYING_OFF))
def an_off_file_that_lies_about(what: str) -> float:
    """A number that is none, a corner or rows that are not there: one line, no mesh."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.off"
        path.write_text(LYING_OFF[what], encoding="ascii")
        return refuses(lambda: read_off(path), what)


@CASES("files", "")
def an_image_header_of_ten_billion_pixels() -> float:
    """Refused by its header: nothing is decoded, and no memory taken."""
    body = struct.pack(">IIBBBBB", 100_000, 100_000, 16, 0, 0, 0, 0)
    chunk = b"IHDR" + body
    data = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))
    return refuses(lambda: decode(data), "header")


class Lines:
    """Lines of our own code that ran while the `with` block did."""

    def __init__(self) -> None:
        self.seen: set[tuple[str, int]] = set()

    def _local(self, frame: FrameType, event: str, argument: Any) -> Any:
        if event == "line":
            self.seen.add((frame.f_code.co_filename, frame.f_lineno))
        return self._local

    def _called(self, frame: FrameType, event: str, argument: Any) -> Any:
        return self._local if any(part in frame.f_code.co_filename for part in OURS) else None

    def __enter__(self) -> Lines:
        sys.settrace(self._called)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(None)


def damage(folder: Path, names: list[str], count: int, seed: int) -> None:
    """What the child does: `count` damaged files for each reader; a line of JSON for each thing found.

    The name and number of every file is written before it is read, so that a crash tells which one it was.
    """
    from cases.mutations import mutate
    from cases.readers import READERS, WHOLE, write_valid

    write_valid(folder)
    readers = [reader for reader in (*READERS, *WHOLE) if reader.name in names]
    for reader in readers:
        reader.read(folder / reader.file)  # what is not valid to begin with would find nothing
    _bound_memory()
    for reader in readers:
        rng = np.random.default_rng([seed, *reader.name.encode()])
        path = folder / reader.file
        valid = path.read_bytes()
        corpus, seen = [valid], set[tuple[str, int]]()
        refused, slowest = 0, 0.0
        for number in range(count):
            # damage on damage is mostly refused at once: every other file is damaged for the first time
            source = valid if rng.random() < 0.5 else corpus[int(rng.integers(len(corpus)))]
            data = mutate(source, rng)
            path.write_bytes(data)
            _tell({"reading": reader.name, "number": number})
            begin, broken = time.process_time(), ""
            with Lines() as lines:
                try:
                    reader.read(path)
                except PalpateError as error:
                    refused += 1
                    if "\n" in str(error):
                        broken = f"a message of several lines: {str(error)[:80]!r}"
                except Exception as error:  # noqa: BLE001  (what is looked for)
                    broken = f"{type(error).__name__}: {str(error)[:120]}"
            seconds = time.process_time() - begin
            slowest = max(slowest, seconds)
            if not broken and seconds > LONGEST:
                broken = f"{seconds:.1f} s for {len(data)} bytes"
            if broken:
                kept = folder.parent / f"{reader.name.replace(' ', '-').replace('/', '-')}-{number}"
                kept.write_bytes(data)
                _tell({"broken": reader.name, "number": number, "with": broken, "file": str(kept)})
            if not lines.seen <= seen and len(corpus) < KEPT and len(data) < 1 << 20:
                seen |= lines.seen
                corpus.append(data)
        path.write_bytes(valid)
        _tell({"done": reader.name, "refused": refused, "slowest": slowest, "kept": len(corpus)})


def _bound_memory() -> None:
    import resource

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * os.sysconf("SC_PAGE_SIZE") + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _tell(fact: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(fact) + "\n")
    sys.stdout.flush()


def read_damaged(names: list[str], count: int, seed: int = 0, keep: Path | None = None) -> dict[str, dict[str, Any]]:
    """Facts by reader after `count` damaged files each; raises Unstable with what broke, or what the child died of.

    keep: a folder for the files that broke something (default: they are lost with the temporary one).
    """
    if not Path("/proc/self/statm").is_file():  # the bound on memory is Linux's
        return {}
    root = Path(__file__).resolve().parents[3]
    with tempfile.TemporaryDirectory() as spare:
        folder = (keep or Path(spare)) / "files"
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, str(folder), "|".join(names), str(count), str(seed)],
            cwd=root,
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join([str(root), str(root / "tests" / "stability")]),
                "PALPATE_THREADS": "1",
                "PYTHONWARNINGS": "ignore",
            },
            capture_output=True,
            text=True,
            check=False,
            timeout=60 + len(names) * count,
        )
    facts = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    broken = [f"{f['broken']} {f['number']}: {f['with']}" for f in facts if "broken" in f]
    last = facts[-1] if facts else {}
    ending = f"ended with {done.returncode} at {last}: {done.stderr.strip()[-200:]}; {'; '.join(broken[:3])}"
    need(done.returncode == 0, f"the reading process {ending}")
    need(not broken, f"{len(broken)} of {len(names) * count} files: {'; '.join(broken[:5])}")
    return {f["done"]: f for f in facts if "done" in f}


GROUPS: dict[str, Callable[[str], bool]] = {
    "JSON": lambda name: name.endswith(".json"),
    "CSV": lambda name: name.endswith(".csv"),
    "meshes and clouds": lambda name: any(word in name for word in ("PLY", "OFF", "OBJ", "STL")),
    "URDF": lambda name: "URDF" in name,
    "PNG": lambda name: "PNG" in name,
}


def _names(group: str) -> list[str]:
    from cases.readers import READERS

    return [reader.name for reader in READERS if GROUPS[group](reader.name)]


def _whole() -> list[str]:
    from cases.readers import WHOLE

    return [reader.name for reader in WHOLE]


def _slowest(facts: dict[str, dict[str, Any]]) -> float:
    return max((fact["slowest"] for fact in facts.values()), default=0.0)


@CASES("files", "slowest file, s")
def damaged_files_of_every_kind(count: int = 30) -> float:
    """30 of each kind, in one child."""
    return _slowest(read_damaged([name for group in GROUPS for name in _names(group)], count))


@CASES("files", "slowest file, s")
def captures_with_a_damaged_file(count: int = 4) -> float:
    """Whole captures, one file of them damaged, read and validated."""
    return _slowest(read_damaged(_whole(), count))


@CASES("files", "slowest file, s", over=tuple(GROUPS), slow=True)
def two_thousand_damaged_files_a_reader(group: str) -> float:
    """2000 of each kind."""
    return _slowest(read_damaged(_names(group), 2000, seed=1))


@CASES("files", "slowest file, s", slow=True)
def a_hundred_captures_with_each_file_damaged() -> float:
    """100 of each."""
    return _slowest(read_damaged(_whole(), 100, seed=1))
