"""Open3D is loaded in one place; Ctrl-C meanwhile is neither lost nor an error of Open3D's."""

from __future__ import annotations

import importlib
import signal
import threading
from types import ModuleType

import pytest

from scenes import _open3d


@pytest.fixture
def loading(monkeypatch):
    """Somebody presses Ctrl-C while Open3D is loaded; returns what was loaded whole."""
    whole, really = [], importlib.import_module

    def load(name, *rest):
        if name != "open3d":
            return really(name, *rest)
        if threading.current_thread() is threading.main_thread():
            signal.raise_signal(signal.SIGINT)
        whole.append(name)
        return ModuleType(name)

    monkeypatch.setattr(importlib, "import_module", load)
    return whole


def test_an_interrupt_comes_when_it_is_loaded_whole(loading):
    # whoever runs the tests may have another answer to it
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            _open3d.open3d.__wrapped__()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert loading == ["open3d"]


def test_whoever_listens_hears_it(loading):
    heard = []
    before = signal.signal(signal.SIGINT, lambda *what: heard.append(what[0]))
    try:
        assert _open3d.open3d.__wrapped__().__name__ == "open3d"
    finally:
        signal.signal(signal.SIGINT, before)
    assert heard == [signal.SIGINT]


def test_other_threads_load_it_as_well(loading):
    found = []
    thread = threading.Thread(target=lambda: found.append(_open3d.open3d.__wrapped__()))
    thread.start()
    thread.join()
    assert found
    assert loading == ["open3d"]
