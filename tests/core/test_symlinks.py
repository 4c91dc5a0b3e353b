"""Links in a folder of results are not followed, because the folder may be a received one."""

import json
from importlib import import_module

import polars as pl
import pytest

from fluxobs import FluxobsError
from fluxobs.campaigns.dataset import TIMES
from fluxobs.comparison import report
from fluxobs.core import plots
from fluxobs.core.engine import locked
from fluxobs.core.output import write_rows, write_text
from fluxobs.core.symlinks import open_own

#: Imports the module, because `fluxobs.campaign` is a function.
campaigns = import_module("fluxobs.campaigns.campaign")


@pytest.fixture
def victim(tmp_path):
    path = tmp_path / "victim"
    path.write_text("mine")
    yield path
    assert path.read_text() == "mine"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "out").mkdir()
    return tmp_path / "out"


def test_a_lock_that_is_a_link(folder, victim):
    (folder / ".lock").symlink_to("../victim")
    with pytest.raises(FluxobsError, match=r"\.lock: is a link"), locked(folder):
        pass


def test_a_lock_keeps_its_content(folder):
    """The lock file may be a hard link to a file elsewhere."""
    (folder / ".lock").write_text("kept")
    with locked(folder):
        pass
    assert (folder / ".lock").read_text() == "kept"


def test_a_folder_of_results_that_is_a_link(folder, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (folder / "rows").mkdir()
    (folder / "rows" / "deep").symlink_to("../../elsewhere")
    with pytest.raises(FluxobsError, match="deep: is a link"), locked(folder):
        pass


def test_a_link_that_comes_after_the_check(folder, victim, monkeypatch):
    (folder / "file").symlink_to("../victim")
    monkeypatch.setattr("fluxobs.core.symlinks.refuse_link", lambda path: None)
    with pytest.raises(FluxobsError, match="cannot be written"):
        open_own(folder / "file")


def test_the_times_file_of_a_campaign_that_is_a_link(folder, victim, monkeypatch):
    class FakeDataset:
        specification = None

        def __init__(self):
            self.folder = folder

        def lacking(self):
            return 0

        def missing(self):
            return []

    class Chunk:
        first, last = 0, 1

    monkeypatch.setattr(campaigns, "total", lambda specification: 0)
    monkeypatch.setattr(campaigns, "compute", lambda *_: [(Chunk, 0.5)])

    def fill():
        campaigns.fill(FakeDataset(), None, 1, "", lambda done, total: None)

    fill()
    fill()  # appends
    assert (folder / TIMES).read_text() == "0,1,0.500\n" * 2
    (folder / TIMES).unlink()
    (folder / TIMES).symlink_to("../victim")
    with pytest.raises(FluxobsError, match="is a link"):
        fill()


def test_unfinished_files_that_are_links(folder, victim):
    """Their names are predictable."""
    for name in (".a.json.part", ".a.png.part", ".a.png.part.png", ".a.csv.part"):
        (folder / name).symlink_to("../victim")
    write_text(folder / "a.json", json.dumps({"é": 1}))
    plots.write(plots.new_figure(), folder / "a.png")
    write_rows(folder / "a.csv", {"x": pl.Int64}, iter([pl.DataFrame({"x": [1]})]))
    assert (folder / "a.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((folder / "a.json").read_text()) == {"é": 1}


def test_results_that_are_links_are_replaced(folder, victim):
    for name in ("scores.csv", "a.svg"):
        (folder / name).symlink_to("../victim")
    report.write_csv([], folder / "scores.csv")
    plots.write(plots.new_figure(), folder / "a.svg")
    for name in ("scores.csv", "a.svg"):
        assert not (folder / name).is_symlink()
