"""Estimates of a stream are those of a log that is estimated as it goes."""

import numpy as np
import pytest

import fluxobs
from fluxobs.errors import FluxobsError
from fluxobs.live import Watch
from fluxobs.live.frames import HEADER, SAMPLES, frame
from fluxobs.simulation.closed_form.demo import LOG

DEMO = LOG.read_bytes()


def watched(watch, data, piece=5000):
    """All that is estimated, as columns."""
    rows = [r for k in range(0, len(data), piece) for r in watch.feed(data[k : k + piece])]
    return {name: np.concatenate([r.columns[name] for r in rows]) for name in rows[0].columns}


@pytest.fixture
def watch(tmp_path):
    def make(machine="servo-400w", **given):
        return Watch(fluxobs.read_machine(machine), tmp_path / "stream", **given)

    return make


@pytest.mark.parametrize(("unknowns", "pieces"), [("auto", 333), ("drift", len(DEMO))])
def test_the_estimates_of_a_log(watch, unknowns, pieces):
    one, other = watch(unknowns=unknowns), watch(unknowns=unknowns)
    found = watched(one, DEMO)
    again = watched(other, DEMO, pieces)
    for name in found:
        assert np.array_equal(found[name], again[name], equal_nan=True), name
    assert len(found["t"]) == one.status.rows == 10_000
    log = fluxobs.estimate(
        fluxobs.demo_log(),
        "servo-400w",
        unknowns=unknowns if unknowns != "auto" else one.unknowns,
        causal=True,
    )
    # only the sizes of the signals, which a stream cannot know before, are others
    known = found["valid"] & log["valid"]
    assert known.sum() > 0.95 * log["valid"].sum()
    off = np.abs(found["theta_e"] - log["theta_e"])[known]
    assert (np.minimum(off, 2 * np.pi - off) < log["theta_e_std"][known]).all()
    rms = [
        np.degrees(np.sqrt(np.mean(e[known] ** 2)))
        for e in (found["theta_e_error"], log["theta_e_error"])
    ]
    assert rms[0] < 1.3 * rms[1] + 0.05


def test_missing_rows_are_bad_samples(watch):
    header, *rows = DEMO.splitlines(keepends=True)
    del rows[5000:5003], rows[7000:7060]
    made = watch()
    found = watched(made, header + b"".join(rows))
    assert made.status.lost == 63
    assert np.allclose(np.diff(found["t"]), 2e-4)
    assert not found["valid"][5001]
    error = np.degrees(np.abs(found["theta_e_error"][found["valid"]]))
    assert error.max() < 1.5


def test_it_waits_for_a_current(watch):
    header, *rows = DEMO.splitlines(keepends=True)
    still = [b"%.4f,0,0,0,0,0\n" % (2e-4 * k) for k in range(12_000)]
    moved = [b"%.4f," % (2.4 + 2e-4 * k) + row.split(b",", 1)[1] for k, row in enumerate(rows)]
    made = watch()
    assert list(made.feed(header + b"".join(still))) == []
    assert "current is zero" in made.status.waiting
    found = watched(made, b"".join(moved))
    assert made.status.waiting == ""
    assert found["valid"][-100:].all()


def test_a_signal_that_grows_gets_an_observer_that_fits(watch):
    """From hardly turning to full speed: what was chosen for the start does not fit the rest."""
    header, *rows = DEMO.splitlines(keepends=True)
    table = np.array([[float(x) for x in row.split(b",")] for row in rows])
    quiet = np.repeat(table[:1], 5000, 0)
    quiet[:, 1:5] = 1e-3 * np.random.default_rng(1).normal(size=(5000, 4))
    quiet[:, 0] = 2e-4 * np.arange(5000)
    table[:, 0] += 1.0
    data = header + b"".join(
        b",".join(b"%.6g" % x for x in row) + b"\n" for row in np.concatenate([quiet, table])
    )
    made = watch()
    found = watched(made, data)
    assert made.status.chosen > 1
    assert found["valid"][-4000:].mean() > 0.9
    assert np.degrees(np.abs(found["theta_e_error"][found["valid"]])).max() < 3


def test_a_recording_is_a_log(watch, tmp_path):
    made, kept = watch(), []
    for k in range(0, 300_000, 4000):
        if k == 120_000:
            made.record(kept.append)
        for _ in made.feed(DEMO[k : k + 4000]):
            pass
    path = tmp_path / "kept.csv"
    path.write_bytes(b"".join(kept))
    log = fluxobs.read_log(path)
    assert len(log) > 3000
    rows = {line.split(b",")[0]: line for line in DEMO.splitlines()}
    assert all(rows[line.split(b",")[0]] == line for line in path.read_bytes().splitlines())


@pytest.mark.parametrize(
    ("data", "given", "words"),
    [
        (DEMO.replace(b"u_alpha", b"foo", 1), {}, "u_alpha"),
        (b"\n".join(line.split(b",", 1)[1] for line in DEMO.splitlines()), {}, "--sample-time"),
        (DEMO, {"unknowns": "speed"}, "unknown"),
        (DEMO, {"memory": 1e-5}, "memory"),
        (DEMO, {"memory": np.nan}, "memory must be a positive"),
        (DEMO, {"frame": "bogus"}, "frame"),
    ],
)
def test_what_cannot_be_estimated_is_said(watch, data, given, words):
    with pytest.raises(FluxobsError, match=words):
        watched(watch(**given), data)


def test_a_stream_in_frames(watch):
    rows = np.array([[float(x) for x in line.split(b",")] for line in DEMO.splitlines()[1:]])
    names = b"2e-4,0,u_alpha,u_beta,i_alpha,i_beta,theta_e"
    data = frame(HEADER, 0, names) + b"".join(
        frame(SAMPLES, k, row[1:].astype("<f4").tobytes()) for k, row in enumerate(rows)
    )
    text, framed = watched(watch(), DEMO), watched(watch(), data)
    assert np.allclose(text["t"], framed["t"])
    off = np.abs(text["theta_e"] - framed["theta_e"])
    off = np.minimum(off, 2 * np.pi - off)
    both = text["valid"] & framed["valid"]
    assert (off < text["theta_e_std"])[both].all()


def test_a_short_stream_is_estimated_when_it_ends(watch):
    made = watch(lag=1)
    data = b"".join(DEMO.splitlines(keepends=True)[:1001]).rstrip(b"\n")
    assert list(made.feed(data)) == []
    rows = list(made.feed(b"", last=True))
    assert sum(len(one.valid) for one in rows) == made.status.rows == 1000


def test_an_empty_stream_ends_in_peace(watch):
    made = watch()
    assert list(made.feed(b"", last=True)) == []
    assert "first 2000 rows" in made.status.waiting


def test_names_that_come_later(watch):
    header, rows = DEMO.split(b"\n", 1)
    made = watch()
    assert list(made.feed(rows)) == []
    assert "a line that names the columns; there is none among 9990 lines" in made.status.waiting
    with pytest.raises(FluxobsError, match="expected a header"):
        list(watch().feed(rows, last=True))
    found = [*made.feed(header + b"\n" + rows[:100_000]), *made.feed(rows[100_000:])]
    assert sum(len(one.valid) for one in found) == 10_000


FIRST, *LINES = DEMO.splitlines(keepends=True)


def stamped(line, t):
    return b"%.4f," % t + line.split(b",", 1)[1]


@pytest.mark.parametrize(
    "lines",
    [
        [*LINES[:6000], *(stamped(line, 2e-4 * k) for k, line in enumerate(LINES[6000:]))],
        [*LINES[:5000], LINES[5001], LINES[5000], *LINES[5002:]],
        [*LINES[:900], LINES[901], LINES[900], *LINES[902:]],
        [*LINES[:5000], stamped(LINES[5000], 1e19), *LINES[5001:]],
        [*LINES[:5000], LINES[5000].replace(b",", b",b", 2), *LINES[5001:]],
        [*LINES[:5000], b"boot: reset by watchdog\n", b"1,2\n", b'x"y\n', *LINES[5000:]],
        [*LINES[:5000], LINES[5000].rsplit(b",", 3)[0] + b"\n", *LINES[5001:]],
    ],
    ids=[*["restart", "exchanged", "early", "stamp", "cell", "text", "short"]],
)
def test_a_recording_of_a_stream_with_mistakes_is_a_log(watch, tmp_path, lines):
    kept, data = [], FIRST + b"".join(lines)
    made = watch()
    made.record(kept.append)
    found = watched(made, data)
    list(made.feed(b"", last=True))
    path = tmp_path / "kept.csv"
    path.write_bytes(b"".join(kept))
    log = fluxobs.read_log(path, sample_time=2e-4)
    assert abs(len(log) - 10_000) <= 2
    assert made.status.lost <= 2
    error = np.degrees(np.abs(found["theta_e_error"][found["valid"]]))
    assert error.max() < 6
    assert found["valid"].mean() > 0.8


def test_what_came_is_kept_until_there_are_rows(watch):
    made = watch()
    made.record(lambda lines: None)
    list(made.feed(LINES[0] * 3000))
    assert made.unread == LINES[0] * 3000
    list(made.feed(DEMO))
    assert made.unread == b""


@pytest.mark.parametrize("grown", ["u", "i"])
@pytest.mark.parametrize(("factor", "chosen"), [(3.4, 1), (4.8, 2)])
def test_four_times_the_first_signals_ask_for_another_observer(watch, grown, factor, chosen):
    """The observer is chosen for twice the measured signals, and again beyond twice that."""
    t = 2e-4 * np.arange(15_000)
    vector = np.exp(1j * 300 * t)
    large = np.where(t > 1.5, factor, 1.0)
    sizes = {name: (large if name == grown else 1.0) for name in ("u", "i")}
    voltage, current = 4 * sizes["u"] * 1j * vector, 2 * sizes["i"] * vector
    table = np.stack([t, voltage.real, voltage.imag, current.real, current.imag], axis=1)
    lines = ["t,u_alpha,u_beta,i_alpha,i_beta", *(",".join(f"{x:.7g}" for x in r) for r in table)]
    made = watch(unknowns="drift")
    watched(made, "\n".join(lines).encode() + b"\n")
    assert made.status.chosen == chosen
