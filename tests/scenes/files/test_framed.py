"""Tables and entries that are read frame by frame say what those read at once say."""

import json

import numpy as np
import pytest

from scenes.errors import CaptureError
from scenes.files.formats import tables
from scenes.files.framed import FramedTable
from scenes.files.problems import refuse
from scenes.recordings import bop

HEAD = "frame,sensor,x,y,z,radius\n"
ROWS = [(i // 3 if i < 12 else (i * 7) % 5, f"s{i % 4}", 0.1 * i, -0.5, 1e-3 * i, 0.01) for i in range(40)]


def same(framed, whole):
    assert (framed.file, framed.texts) == (whole.file, whole.texts)
    assert np.array_equal(framed.lines, whole.lines)
    assert set(framed.numbers) == set(whole.numbers)
    for name, values in whole.numbers.items():
        assert np.array_equal(framed.numbers[name], values, equal_nan=True)


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_each_frame_has_the_rows_that_the_whole_has(tmp_path, ending, mark):
    text = HEAD + "\n".join(f"{f},{s},{x!r},{y!r},{z!r},{r!r}" for f, s, x, y, z, r in ROWS) + "\n\n"
    lines = text.split("\n")
    lines.insert(5, "")  # blank lines, names beyond ASCII and quoted cells that run over a line
    lines[9] = lines[9].replace("s", "größe ")
    lines[12] = lines[12].replace(",s", ',"two\nlines ').replace(",1", '",1', 1).replace(",0", '",0', 1)
    path = tmp_path / "t.csv"
    path.write_bytes((mark + "\n".join(lines)).replace("\n", ending).encode())
    problems, others = [], []
    framed, whole = FramedTable(path, tables.NO_CONTACT, problems.append), None
    whole = tables.read_table(path, tables.NO_CONTACT, others.append)
    assert set(framed.frames()) == set(whole.frames())
    for frame in range(14):
        found, expected = framed.of_frame(frame), whole.of_frame(frame)
        if any("\n" in name for table in (found, expected) for name in table.texts.get("sensor", ())):
            found, expected = found.numbers["x"], expected.numbers["x"]
            assert np.array_equal(found, expected)
        elif len(expected):
            same(found, expected)
        else:
            assert len(found) == 0


def test_problems_are_reported_once_with_their_lines_and_the_rest_is_read(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text(HEAD + "0,a,1,2,3,4\n0,b,x,2,3,4\n1,c,1,2\n1,d,1,2,3,4\n0,e,5,2,3,inf\n0,f,6,2,3,4\n")
    reports = [[], []]
    framed = FramedTable(path, tables.NO_CONTACT, reports[0].append)
    whole = tables.read_table(path, tables.NO_CONTACT, reports[1].append)
    assert reports[0] == reports[1]
    assert len(reports[0]) == 3
    for frame in (0, 1):
        same(framed.of_frame(frame), whole.of_frame(frame))
    assert len(reports[0]) == 3
    with pytest.raises(CaptureError, match="line 3, column x: expected a number, got 'x'"):
        FramedTable(path, tables.NO_CONTACT, refuse)


@pytest.mark.parametrize(
    "content", [b"", b"frame,sensor\n0,a\n", b"\xff\xfe\n", b"frame,sensor,x,y,z,radius\n0,\xff,1,2,3,4\n"]
)
def test_a_file_that_is_none_says_the_same(tmp_path, content):
    path = tmp_path / "t.csv"
    path.write_bytes(content)
    reports = [[], []]
    framed = FramedTable(path, tables.NO_CONTACT, reports[0].append)
    tables.read_table(path, tables.NO_CONTACT, reports[1].append)
    assert reports[0] == reports[1]
    assert len(reports[0]) == 1
    assert len(framed.of_frame(0)) == len(framed.frames()) == 0


@pytest.mark.parametrize(
    "text", ["{}", ' { "3" : [1, {"a": "}"}] ,\n"0":null} \n', '\ufeff{"1": {"x": NaN}, "2": 2}', '{"0": "é\\u0020,"}']
)
def test_entries_are_what_json_says(tmp_path, text):
    path = tmp_path / "e.json"
    path.write_text(text, encoding="utf-8")
    expected = {int(k): v for k, v in json.loads(text.lstrip("\ufeff")).items()}
    found = bop.read_frames(path, refuse)
    assert isinstance(found, bop.FrameEntries) == text.lstrip("\ufeff").isascii()
    assert str(dict(found)) == str(expected)
    assert (len(found), 99 in found, list(found)) == (len(expected), False, list(expected))


def test_entries_of_a_file_that_has_changed_are_refused(tmp_path):
    path = tmp_path / "e.json"
    path.write_text('{"7": [1, 2], "3": {"a": 1}}')
    found = bop.read_frames(path, refuse)
    assert (found[3], found[7]) == ({"a": 1}, [1, 2])
    with pytest.raises(KeyError):
        found[5]
    path.write_text('{"7": [')
    with pytest.raises(CaptureError, match="frame 3: expected the file as it was"):
        found[3]


@pytest.mark.parametrize(
    "text", ["", "[]", "{", '{"0": 1,}', '{"0": 1} x', '{"0" 1}', '{"0": 1 "1": 2}', '{"a": 1}', '{"0": tru}']
)
def test_what_is_no_entries_is_told_as_ever(tmp_path, text):
    path = tmp_path / "e.json"
    path.write_text(text)
    with pytest.raises(CaptureError, match=r"e\.json"):
        bop.read_frames(path, refuse)
