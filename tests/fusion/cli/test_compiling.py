"""What a first run says of its compiling: how many kernels, how long, in place on a terminal and by lines elsewhere."""

import io
from types import SimpleNamespace

import numba
import pytest
from numba.core import event

from fusion.cli import compiling


class Screen(io.StringIO):
    """A terminal that keeps all that was written."""

    def isatty(self) -> bool:
        return True


class Clock:
    """Seconds that pass when told to."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_a_kernel_within_another_is_not_counted_and_a_pipe_has_a_line_now_and_then():
    clock, pipe = Clock(), io.StringIO()
    progress = compiling.Progress(pipe, clock)
    for k in range(4):
        clock.now = 6.0 * k
        progress.begin(f"room.outer{k}")
        progress.begin("room.inner")
        progress.end()
        progress.end()
    assert progress.count == 4
    assert pipe.getvalue() == f"compiling kernel 3 of about {compiling.USUAL}, 12 s so far: room.outer2\n"


def test_on_a_terminal_one_line_is_written_over_and_taken_away():
    screen = Screen()
    progress = compiling.Progress(screen, Clock())
    progress.begin("room." + "long" * 40)
    shown = screen.getvalue()
    assert shown.startswith("\r\x1b[K")
    assert "\n" not in shown
    assert len(shown) <= 4 + 79
    progress.end()
    assert screen.getvalue() == shown + "\r\x1b[K"


def test_a_progress_bar_keeps_its_line():
    screen, clock = Screen(), Clock()
    screen.rich_proxied_file = screen
    progress = compiling.Progress(screen, clock)
    clock.now = compiling.SAID_EVERY
    progress.begin("room.kernel")
    progress.end()
    assert screen.getvalue() == f"compiling kernel 1 of about {compiling.USUAL}, 10 s so far: room.kernel\n"


def test_no_end_is_promised_beyond_the_usual_count():
    clock, pipe = Clock(), io.StringIO()
    progress = compiling.Progress(pipe, clock)
    for _ in range(compiling.USUAL + 1):
        clock.now += compiling.SAID_EVERY
        progress.begin("room.kernel")
        progress.end()
    assert pipe.getvalue().splitlines()[-1].startswith(f"compiling kernel {compiling.USUAL + 1}, ")


@pytest.mark.parametrize(("known", "lines"), [(False, 1), (True, 0)])
def test_it_is_said_on_a_first_run_only(monkeypatch, capsys, tmp_path, known, lines):
    heard = []
    monkeypatch.setattr(compiling, "kernels_compiled", lambda: (known, tmp_path))
    monkeypatch.setattr(event, "register", lambda kind, listener: heard.append(kind))
    compiling.announce_compiling()
    out, err = capsys.readouterr()
    assert not out
    assert len(err.splitlines()) == len(heard) == lines
    assert known or compiling.TAKES in err


def test_numba_tells_of_the_kernels_that_it_compiles():
    told = []
    progress = SimpleNamespace(begin=told.append, end=lambda: told.append(None))

    @numba.njit
    def inner(x):
        return x + 1

    @numba.njit
    def outer(x):
        return inner(x) * 2

    with event.install_listener("numba:compile", compiling._listening(progress)):
        assert outer(1) == 4
    names = [name.rsplit(".", 1)[-1] for name in told if name is not None]
    assert names[:2] == ["outer", "inner"]
    assert told.count(None) == len(names)
