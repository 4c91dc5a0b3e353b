"""What the terminal says of a stream, a line at a time."""

import numpy as np
import pytest

from fluxobs.estimation.columns import Rows
from fluxobs.live.sources import Demo
from fluxobs.live.terminal import Terminal
from fluxobs.live.watch import Watch
from fluxobs.machines import example


@pytest.fixture
def at(monkeypatch):
    clock = [100.0]
    monkeypatch.setattr("fluxobs.live.terminal.time.monotonic", lambda: clock[0])
    return clock


def rows(theta, valid):
    columns = {"theta_e": np.array([theta]), "speed_e": np.array([10.0])}
    return Rows(columns, np.array([valid]), None, None, {})


def test_lines_of_a_stream(tmp_path, capsys, at):
    source = Demo()
    terminal = Terminal(Watch(example("servo-400w"), tmp_path / "stream"), source)

    def line(seconds, *come):
        at[0] += seconds
        for part in come:
            terminal.add(part)
        terminal.draw()
        return capsys.readouterr().out.strip()

    waits = ", waiting: the stream's first 2000 rows"
    assert line(0) == waits[2:]
    assert line(1) == "", "nothing new is no new line"
    assert line(1, rows(np.radians(5), True)) == f"theta_e 5°, speed_e 10 rad/s, valid 100%{waits}"
    assert line(0.5, rows(np.radians(6), True)) == "", "one line a second"
    silent = ", no rows for more than 2 s"
    assert line(1) == f"theta_e 6°, speed_e 10 rad/s, valid 100%{waits}"
    assert line(2).endswith(waits + silent)
    assert line(1) == ""
    found = line(1, rows(np.radians(7), False))
    assert found.startswith("theta_e –, speed_e –, valid 0%"), "a value that is not valid is none"
    assert silent not in found
    source.ignored = 3
    assert ", 3 of other senders" in line(1)
    source.name = "\x1b[31mcaf\udce9.csv"
    assert str(terminal._table().title).startswith(r"\x1b[31mcaf\xe9.csv: 0 rows")
