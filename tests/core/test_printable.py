"""Names from outside are shown as plain text, without control characters."""

import json

import pytest

from fluxobs.core import html, plots
from fluxobs.core.printable import visible
from fluxobs.page import in_script


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("é Ω 😀\tx\ny", "é Ω 😀\tx\ny"),
        ("\x1b[31m \x9b2J \x7f \r", r"\x1b[31m \x9b2J \x7f \x0d"),
        ("caf\udce9 \ud83d", r"caf\xe9 \ud83d"),
    ],
)
def test_visible_text(text, shown):
    assert visible(text) == shown
    assert html.escape(text) == shown
    assert shown.encode()


def test_a_label_is_not_read_as_a_formula():
    figure = plots.new_figure()
    title = figure.suptitle(plots.plain("$\\frac$ caf\udce9 $"))
    figure.canvas.draw()
    assert title.get_text() == r"\$\frac\$ caf\xe9 \$"


def test_a_page_keeps_a_name_that_is_not_valid_text():
    text = in_script({"name": "caf\udce9</script>"})
    assert text.encode() == rb'{"name": "caf\udce9\u003c/script>"}'
    assert json.loads(text) == {"name": "caf\udce9</script>"}
