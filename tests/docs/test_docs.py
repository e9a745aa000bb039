"""The pages of the documentation, typed as they stand: their commands, their Python, and what they say is printed."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import cv2
import docs_commands
import numpy as np
import pytest
from docs_commands import ROOT, matches

from fusion.cli.parser import build_parser
from scenes.files.formats.ply import write_ply
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.recording import synthesize

DOCS = ROOT / "docs"
README = ROOT / "README.md"
TABLES = DOCS / "benchmarks"
PAGES = [README, *sorted(DOCS.glob("*.md")), *sorted((DOCS / "method").glob("*.md")), *sorted(TABLES.glob("*.md"))]
# Pages whose blocks are run below, and those that another test runs or whose recordings and minutes no test has: of
# these every command is held against the parser.
RUN_HERE = {"tutorial.md", "live.md", "faq.md", "README.md", "commands.md", "gallery.md", "gels.md"}
ONLY_PARSED = {
    "formats.md": "test_formats_docs.py runs it on recordings that it makes",
    "scenes.md": "one block, which downloads",
    "evaluation.md": "benches take minutes to hours",
}


def test_the_tutorial_ends_at_the_object(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = docs_commands.run(DOCS / "tutorial.md", tmp_path)
    moved = names["answer"].pose[:3, 3] - names["truth"][:3, 3]
    assert np.linalg.norm(moved) < 0.003
    assert (tmp_path / "out/bracket/report.html").is_file()


def test_a_tracker_runs_live(tmp_path, monkeypatch):
    """Fed by a callback and by a bag that grows, with frames missing and late."""
    pytest.importorskip("rosbags", reason="the extra ros is not installed")
    monkeypatch.chdir(tmp_path)
    names = docs_commands.run(DOCS / "live.md", tmp_path)
    truth = {frame.index: frame.camera_from_object_truth for frame in names["frames"]}
    for answer in names["seen"][-1], names["one"]:
        assert np.linalg.norm(answer.pose[:3, 3] - truth[answer.frame][:3, 3]) < 0.02


def test_gels_are_made_and_used_as_their_page_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    docs_commands.run(DOCS / "gels.md", tmp_path)
    assert (tmp_path / "out/gel/report.html").is_file()


@pytest.mark.slow
def test_mistakes_are_told_as_the_page_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    docs_commands.run(DOCS / "faq.md", tmp_path)


@pytest.mark.slow
def test_every_command_has_an_example_that_works(tmp_path, monkeypatch):
    """In their order."""
    monkeypatch.chdir(tmp_path)
    docs_commands.run(DOCS / "commands.md", tmp_path)
    assert (tmp_path / "out/all/index.html").is_file()
    assert (tmp_path / "drill.ply").is_file()


def test_the_gallery_has_its_scenes_and_pictures():
    """As docs/build_gallery.py has them, in a megabyte and a half."""
    page, made = (DOCS / "gallery.md").read_text(encoding="utf-8"), docs_commands.script("build_gallery")
    typed = [
        line.split("  # ")[0]
        for block in docs_commands.blocks(DOCS / "gallery.md", "sh")
        for line in block.splitlines()
    ]
    assert typed == [line.split("  # ")[0] for scene in made.SCENES for line in scene.lines]
    assert re.findall(r"^## (.*)$", page, re.MULTILINE) == [scene.title for scene in made.SCENES]
    pictures = sorted(path.name for path in made.PICTURES.iterdir())
    assert pictures == sorted(f"{scene.name}.jpg" for scene in made.SCENES)
    assert sum(path.stat().st_size for path in made.PICTURES.iterdir()) < 1.5e6
    assert len(made.SCENES) == 12


@pytest.mark.slow
def test_the_gallery_is_what_its_commands_print(tmp_path, monkeypatch):
    """Each verdict; a shell's exit code says which are lost."""
    monkeypatch.chdir(tmp_path)
    docs_commands.run(DOCS / "gallery.md", tmp_path)
    told = re.findall(r"The answer is \*\*(\w+)\*\*", (DOCS / "gallery.md").read_text(encoding="utf-8"))
    scenes = docs_commands.script("build_gallery").SCENES
    said = {}
    for scene in scenes:
        (frame,) = json.loads((tmp_path / "out" / scene.name / "result.json").read_text())["frames"]
        said[scene.name] = frame["verdict"]
    assert said == dict(zip([scene.name for scene in scenes], told)), "run `make gallery`"


def test_the_front_page(tmp_path, monkeypatch):
    """Its Python, with a drill, a capture of it, that capture's arrays, and contacts."""
    monkeypatch.chdir(tmp_path)
    drill = library.make("drill")
    write_ply(tmp_path / "drill.ply", drill.vertices, drill.faces)
    capture = synthesize(tmp_path / "captures/drill", drill, five_finger_hand(), occlusion=0.3, noise="clean", seed=1)
    seen = capture[0]
    cv2.imwrite(str(tmp_path / "depth.png"), np.rint(1e3 * seen.depth).astype(np.uint16))
    np.savetxt(tmp_path / "contacts.txt", seen.contacts.points)
    points, normals = drill.sample_surface(6, seed=0)
    live = [(seen.depth, seen.contacts.points)] * 3
    names = docs_commands.run(README, tmp_path, {"points": points, "normals": normals, "sensors": live})
    assert names["answer"].verdict in ("ok", "ambiguous")
    assert len(names["where"].modes) >= 1


def test_pages_are_known():
    """A new page is run, or it is said why not."""
    told = RUN_HERE | set(ONLY_PARSED)
    # benches take minutes to hours, and some need recorded contact sets: their pages are only parsed
    pages = [page for page in PAGES if page.parent != TABLES]
    unknown = [page.name for page in pages if docs_commands.all_blocks(page) and page.name not in told]
    silent = {"api.md", "architecture.md", "choices.md", "method.md"}
    assert set(unknown) <= silent
    for name in silent:
        assert not [b for b in docs_commands.all_blocks(DOCS / name) if b.language in ("sh", "python")]


def name_of(page):
    return f"{page.parent.name}/{page.name}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_command_is_one(page):
    """Names and options of every call of palpate on every page, what is not run included."""
    parser = build_parser()
    for argv in docs_commands.commands(page):
        if "--help" not in argv:
            parser.parse_args(argv)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page):
    """Files, and headings of files, by GitHub's rule for their names."""
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        name, _, heading = target.partition("#")
        if name.startswith(("http://", "https://")):
            continue
        path = page.parent / name if name else page
        assert path.exists(), f"{page.name}: {target}"
        if heading:
            text = path.read_text(encoding="utf-8")
            heads = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
            names = {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}
            assert heading in names, f"{page.name}: {target}"


def test_the_site_names_every_page():
    """`make docs` has the same pages; its own front page leads to all of them."""
    config = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    named = set(re.findall(r"^ +- .*: ([\w/]+\.md)$", config, re.MULTILINE))
    assert named == {page.relative_to(DOCS).as_posix() for page in PAGES if page != README}
    front, tables = ((folder / "index.md").read_text(encoding="utf-8") for folder in (DOCS, TABLES))
    method = (DOCS / "method.md").read_text(encoding="utf-8")
    assert all(f"({name})" in method for name in named if name.startswith("method/"))
    own = {name.removeprefix("benchmarks/") for name in named if name.startswith("benchmarks/")}
    assert all(f"({name})" in tables for name in own - {"index.md"})
    others = {name for name in named if "/" not in name} | {"benchmarks/index.md"}
    assert all(f"({name})" in front for name in others - {"index.md"})


@pytest.mark.slow
def test_the_site_is_built_and_fetches_nothing(tmp_path):
    pytest.importorskip("mkdocs", reason="the extra docs is not installed")
    build = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(tmp_path / "site")]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    for page in (tmp_path / "site").rglob("*.html"):
        assert not re.search(r'<(?:script|link|img)[^>]+(?:src|href)="https?://', page.read_text(encoding="utf-8"))


def test_the_house_is_as_the_page_has_it():
    """Files and folders named on the page are there."""
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    named = re.findall(r"`((?:scenes|vision|touch|fusion|tests)/[\w/.]*)`", text)
    assert len(named) > 20
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_tables_of_benchmarks_are_put_into_their_pages(tmp_path):
    made = docs_commands.script("build_benchmarks")
    mark = "<!-- table search: By what; columns: who=sense | missed; rows: start=yes -->"
    page = f"text\n{mark}\nold\n<!-- end -->\nmore\n"
    assert made.rebuilt(page, [tmp_path]) == page
    rows = "| sense | start | missed |\n| --- | --- | --- |\n| fused | yes | 1 % |\n| fused | no | 2 % |\n"
    head = "# search: whose fault\n\n`palpate bench search --out out/bench`\n\n1 trial; seed 0; Python 3.11\n"
    report = f"{head}\n## By what is told\n\n{rows}\nnote\n"
    (tmp_path / "search.md").write_text(report, encoding="utf-8")
    new = made.rebuilt(page, [tmp_path])
    assert "| who | missed |\n| --- | --- |\n| fused | 1 % |\n\n*`palpate bench search`; 1 trial; seed 0*" in new
    assert "old" not in new
    assert made.rebuilt(new, [tmp_path]) == new
    for wrong in ("columns: none", "rows: start=maybe", "size: 3"):
        with pytest.raises(ValueError, match="expected"):
            made.rebuilt(page.replace("rows: start=yes", wrong), [tmp_path])


def test_tables_of_nowhere_are_refused(tmp_path, monkeypatch, capsys):
    made = docs_commands.script("build_benchmarks")
    for folders in ([], [str(tmp_path / "nowhere")]):
        monkeypatch.setattr(sys, "argv", ["build_benchmarks.py", *folders])
        assert made.main() == 2
        assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("page", sorted(TABLES.glob("*.md")), ids=name_of)
def test_marks_of_tables_are_read(page):
    made, text = docs_commands.script("build_benchmarks"), page.read_text(encoding="utf-8")
    assert len(made.MARKED.findall(text)) == text.count("<!-- table ") == text.count("<!-- end -->")
    for what in re.findall(r"<!-- table (.*?) -->", text):
        assert made.asked_of(what).title


def test_reasons_are_given_for_what_is_not_run():
    for page in PAGES:
        for block in docs_commands.all_blocks(page):
            assert block.left_out is None or len(block.left_out.split()) >= 3, f"{page.name}, line {block.line}"


def test_output_is_compared_line_by_line_with_gaps():
    said = "one\n  two   2.5 mm\nthree"
    assert matches("one\ntwo … mm", said)
    assert matches("two 2.5 mm", said)
    assert not matches("two … mm\none", said)
    assert not matches("two", said)
