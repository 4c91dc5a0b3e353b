"""The numbers in README.md and docs/ are those of docs/numbers/, which benchmarks write."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "benchmarks"))  # last: its modules have everyday names

import docs_numbers  # noqa: E402
import numbers_data  # noqa: E402
import numbers_pages  # noqa: E402
import score_page  # noqa: E402

#: Compilers and libraries of other versions give pages of other sizes.
PAGE_SIZE_TOLERANCE = 0.03
PAGES = numbers_pages.pages()
RESULTS = numbers_data.names()


@pytest.fixture
def page(tmp_path, monkeypatch):
    """A page with a value and a table, and their data."""
    (tmp_path / "numbers").mkdir()
    for module in (numbers_data, numbers_pages):
        monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(numbers_data, "NUMBERS", tmp_path / "numbers")
    monkeypatch.setattr(sys, "argv", [str(tmp_path / "drift.py"), "--write"])
    monkeypatch.setattr(numbers_data, "revision", lambda files: "0123abcd")
    numbers_pages._data.cache_clear()
    with numbers_data.Numbers("drift") as numbers:
        numbers.value("mean", -1.234, "{:.1f}°")
        numbers.value("range", [1, 2], "{}–{} ms")
        numbers.table("logs", ["log", "mean"], [["a", "-1.2°"], ["b", ""]])
    path = tmp_path / "page.md"
    path.write_text(
        "Mean <!--= drift.mean -->?<!--/-->, <!--= drift.range -->?<!--/-->.\n\n"
        "<!-- numbers: drift.logs -->\n<!-- end -->\n"
    )
    monkeypatch.setattr(numbers_pages, "pages", lambda: [path])
    monkeypatch.setattr(docs_numbers, "pages", lambda: [path])
    monkeypatch.setattr(docs_numbers, "relative", lambda path: path.name)
    yield path
    numbers_pages._data.cache_clear()


def test_a_page_is_filled_from_its_data(page):
    assert docs_numbers.check() == 1
    docs_numbers.render()
    assert docs_numbers.check() == 0
    today = numbers_data.date.today().isoformat()
    assert page.read_text() == (
        "Mean <!--= drift.mean -->−1.2°<!--/-->, <!--= drift.range -->1–2 ms<!--/-->.\n\n"
        "<!-- numbers: drift.logs -->\n"
        "| log | mean |\n|---|---|\n| a | −1.2° |\n| b | |\n\n"
        f"*drift.py, revision 0123abcd, {today}*\n<!-- end -->\n"
    )


@pytest.mark.parametrize(
    ("key", "made", "typed"),
    [("drift.mean", "−1.2°<!", "−1.3°<!"), ("drift.logs", "| −1.2° |", "| −1.1° |")],
)
def test_a_typed_digit_is_reported(page, capsys, key, made, typed):
    docs_numbers.render()
    page.write_text(page.read_text().replace(made, typed))
    capsys.readouterr()
    assert docs_numbers.check() == 1
    printed = capsys.readouterr().out
    assert printed.startswith(f"page.md: {key}: ")
    assert all(text.strip("<!") in printed for text in (made, typed))


def test_an_unknown_key_is_an_error(page):
    page.write_text("Mean <!--= drift.median -->1<!--/-->\n")
    with pytest.raises(numbers_pages.UnknownKeyError, match=r"drift\.median"):
        docs_numbers.check()


def test_a_number_that_begins_a_line_is_an_error(page):
    """Its comment would begin a block of HTML."""
    page.write_text("\n- <!--= drift.mean -->1<!--/--> is the mean\n")
    with pytest.raises(numbers_pages.UnknownKeyError, match=r"page\.md:2: .* begin a line"):
        docs_numbers.check()


def test_a_result_is_stale_when_a_source_changes(page, capsys):
    (page.parent / "drift.py").write_text("print(1.3)\n")
    with numbers_data.Numbers("drift"):
        pass
    docs_numbers.stale()
    assert capsys.readouterr().out.endswith("drift.json\n")
    (page.parent / "drift.py").write_text("print(1.4)\n")
    docs_numbers.stale()
    printed = capsys.readouterr().out
    assert "drift.py changed" in printed
    assert "python drift.py --write" in printed


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_pages_show_the_numbers_of_their_data(path):
    content = path.read_text(encoding="utf-8")
    filled = numbers_pages.filled(path, content)
    assert list(map(str, filled.differences)) == []
    opened = len(re.findall(r"<!--=|<!-- numbers:", content))
    places = len(numbers_pages.VALUE.findall(content) + numbers_pages.TABLE.findall(content))
    assert opened == places, "a marked place has no end"


def test_every_result_is_in_the_docs():
    keys = {
        key.partition(".")[0]
        for path in PAGES
        for key in numbers_pages.filled(path, path.read_text(encoding="utf-8")).keys
    }
    assert keys == set(RESULTS)


@pytest.mark.parametrize("name", RESULTS)
def test_the_command_of_a_result_exists(name):
    data = numbers_data.read(name)
    words = shlex.split(data["command"])
    named = next((word for word in words if "/" in word), None)
    script = named or f"src/fluxobs/cli/commands/{words[1]}.py"
    assert (ROOT / script).is_file()
    assert script in data["sources"]
    assert isinstance(data["quick"], bool)
    writes = re.search(r"with Numbers\(", (ROOT / script).read_text(encoding="utf-8"))
    assert writes or data.get("copied"), "the command does not write its numbers"


@pytest.mark.parametrize("name", ["page", "report"])
def test_size_of_the_built_page(name):
    """`make test` builds the files."""
    stored = numbers_data.read("page_size")["values"][name]["value"]  # [kB]
    built = (ROOT / "src/fluxobs/page" / f"{name}.html").stat().st_size / 1e3
    assert built == pytest.approx(stored, rel=PAGE_SIZE_TOLERANCE)


def test_page_of_the_scores_is_made_from_its_numbers():
    made = score_page.page()
    assert score_page.PAGE.read_text(encoding="utf-8") == made, "run benchmarks/score_page.py"
