"""Results in a notebook are complete and escaped, and have the numbers of the text."""

from html.parser import HTMLParser

import pytest

import fluxobs
from fluxobs.core.html import table

VOID = ("img",)


class Checked(HTMLParser):
    """A parser that collects the text and requires that tags are closed in order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.words, self.images = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        if tag in VOID:
            self.images.append(dict(attributes))
        else:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture(scope="module")
def log():
    return fluxobs.demo_log()


def test_a_result(log):
    result = fluxobs.estimate(log, "servo-400w", unknowns="drift")
    shown = Checked(result._repr_html_())
    for label, value in result.summary_rows:
        assert label in shown.words
        assert value in shown.words
    assert shown.images[0]["src"].startswith("data:image/png;base64,")
    assert shown.images[0]["alt"] == result.summary


def test_a_machine():
    words = Checked(fluxobs.example("servo-400w")._repr_html_()).words
    for name, value, unit in (("R_s", "0.36", "Ω"), ("n_p", "4", "pole pairs")):
        index = words.index(name)
        assert words[index : index + 3] == [name, value, unit]
    assert "maglev-2dof" in Checked(fluxobs.example("maglev-knospe")._repr_html_()).words


def test_an_identification(log):
    identification = fluxobs.identify(log, "servo-400w")
    shown = Checked(identification._repr_html_())
    assert (
        f"{identification.parameters[0].value:.4g} ± {identification.parameters[0].std:.2g}"
        in shown.words
    )
    assert any("The position is valid on" in text for text in shown.words)


def test_an_examination(log):
    words = Checked(fluxobs.check(log, "servo-400w")._repr_html_()).words
    assert "magnet flux" in words
    assert "fine" in words


def test_texts_are_escaped():
    text = table(("<a>",), [("x & <b>",)], '"c"')
    assert Checked(text).words == ['"c"', "<a>", "x & <b>"]
    assert "<b>" not in text
