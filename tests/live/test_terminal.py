"""Lines and table of a stream in the terminal."""

import numpy as np
import pytest

from fluxobs.estimation.columns import EstimateRows
from fluxobs.live.sources import Demo
from fluxobs.live.terminal import Terminal, shown, sparkline
from fluxobs.live.watch import Watch
from fluxobs.machines import example


@pytest.fixture
def at(monkeypatch):
    clock = [100.0]
    monkeypatch.setattr("fluxobs.live.terminal.time.monotonic", lambda: clock[0])
    return clock


def rows(theta, valid):
    columns = {"theta_e": np.array([theta]), "speed_e": np.array([10.0])}
    return EstimateRows(columns, np.array([valid]), None, None, {})


def test_lines_of_a_stream(tmp_path, capsys, at):
    source = Demo()
    terminal = Terminal(Watch(example("servo-400w"), tmp_path / "stream"), source)

    def line(seconds, *arrived):
        at[0] += seconds
        for estimates in arrived:
            terminal.add(estimates)
        terminal.draw()
        return capsys.readouterr().out.strip()

    waits = ", waiting: the stream's first 2000 rows"
    assert line(0) == waits[2:]
    assert line(1) == "", "no new rows, no new line"
    assert line(1, rows(np.radians(5), True)) == f"theta_e 5°, speed_e 10 rad/s, valid 100%{waits}"
    assert line(0.5, rows(np.radians(6), True)) == "", "one line a second"
    silent = ", no rows for more than 2 s"
    assert line(1) == f"theta_e 6°, speed_e 10 rad/s, valid 100%{waits}"
    assert line(2).endswith(waits + silent)
    assert line(1) == ""
    invalid = line(1, rows(np.radians(7), False))
    assert invalid.startswith("theta_e –, speed_e –, valid 0%"), "an invalid value is not shown"
    assert silent not in invalid
    source.ignored = 3
    assert ", 3 from other senders" in line(1)
    source.name = "\x1b[31mcaf\udce9.csv"
    assert str(terminal._table().title).startswith(r"\x1b[31mcaf\xe9.csv: 0 rows")


def test_the_table_has_values_and_sparklines(tmp_path, at):
    terminal = Terminal(Watch(example("servo-400w"), tmp_path / "stream"), Demo())
    for theta in (10.0, 20.0, 45.0):
        at[0] += 1.0
        terminal.add(rows(np.radians(theta), True))
        terminal.draw(force=True)
    name, now, strip = (list(column.cells) for column in terminal._table().columns)
    assert name == ["theta_e", "speed_e", "valid"]
    assert now == ["45°", "10 rad/s", "100%"]
    assert strip == ["▁▃█", "▁▁▁", "▁▁▁"]
    assert [column.justify for column in terminal._table().columns] == ["left", "right", "left"]


@pytest.mark.parametrize(
    ("values", "strip"),
    [
        ([], ""),
        ([np.nan], ""),
        ([3.0], "▁"),
        ([0, 1, 2, 3, 4, 5, 6, 7], "▁▂▃▄▅▆▇█"),
        ([7.0, np.nan, 0.0], "█ ▁"),
        ([-1.0, np.inf, 1.0], "▁ █"),
    ],
)
def test_sparkline(values, strip):
    assert sparkline(values) == strip


def test_sparklines_are_at_most_forty_long(tmp_path, at):
    terminal = Terminal(Watch(example("servo-400w"), tmp_path / "stream"), Demo())
    for _ in range(50):
        terminal.add(rows(0.1, True))
        terminal.draw(force=True)
    assert {len(strip) for strip in terminal._strips.values()} == {40}


def test_columns_shown():
    servo, levitation = (shown(example(name)) for name in ("servo-400w", "maglev-knospe"))
    assert servo[:3] == [
        ("t", "s", 1.0),
        *((name, "°", pytest.approx(180 / np.pi)) for name in ("theta_e", "theta_e_std")),
    ]
    assert servo[5:7] == [("drift_alpha", "V", 1.0), ("drift_beta", "V", 1.0)]
    assert levitation[1] == ("position", " µm", 1e6)
    assert levitation[5:7] == [("drift_1", "V", 1.0), ("drift_2", "V", 1.0)]
    assert servo[7:] == [
        ("resistance", "Ω", 1.0),
        ("inverter_voltage", "V", 1.0),
        ("psi_f", "Wb", 1.0),
    ]
