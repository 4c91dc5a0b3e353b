"""HTML files that commands write: reports and the page."""

import re

import pytest

from fluxobs import demo_log
from fluxobs.core.html import document, paragraph
from support.cli import fluxobs

LOG = demo_log().path


def check_self_contained(text):
    """Check that a document loads nothing from elsewhere."""
    assert text.startswith("<!doctype html>")
    assert not re.findall(r'(?:src|href)="(?!data:)', text)
    assert "default-src 'none'" in text


def test_estimate_writes_a_report(tmp_path):
    run = ("estimate", LOG, "--machine", "servo-400w", "--report", "r.html")
    done = fluxobs(*run, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Written: r.html" in done.stdout
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    check_self_contained(text)
    assert re.search(
        r"0\.\d\d° rms, \d\.\d\d° at most, mean -?\d\.\d\d°, on 10000 valid rows", text
    )
    again = fluxobs(*run, folder=tmp_path)
    assert again.returncode == 2
    assert "r.html" in again.stderr
    bare = fluxobs(*run, "--force", "--no-data", folder=tmp_path)
    assert bare.returncode == 0, bare.stderr
    assert '"record": null' in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_the_page_is_written_once(tmp_path):
    done = fluxobs("page", "--out", "p.html", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    check_self_contained((tmp_path / "p.html").read_text(encoding="utf-8"))
    assert (tmp_path / "p.html").stat().st_size < 470_000
    assert fluxobs("page", "--out", "p.html", folder=tmp_path).returncode == 2
    wrong = fluxobs("page", "--out", "p.txt", folder=tmp_path)
    assert wrong.returncode == 2
    assert ".html" in wrong.stderr


@pytest.mark.parametrize(
    ("command", "text_in_report"),
    [
        (("check", LOG, "--machine", "servo-400w"), "winding temperature"),
        (("identify", LOG, "--machine", "servo-400w", "--out", "f.toml"), "inverter"),
    ],
)
def test_check_and_identify_write_html(tmp_path, command, text_in_report):
    done = fluxobs(*command, "--report", "r.html", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    check_self_contained(text)
    assert text_in_report in text


def test_markup_in_a_log_is_escaped():
    markup = "<script>alert(1)</script>"
    assert "<script>" not in document(markup, paragraph(markup))
