"""Live estimates of a stream equal the filtered estimates of the same log."""

import numpy as np
import pytest

import fluxobs
from fluxobs.errors import FluxobsError
from fluxobs.live import Watch
from fluxobs.live.frames import HEADER, SAMPLES, frame
from fluxobs.simulation.closed_form.demo import LOG

DEMO = LOG.read_bytes()


def watched(watch, data, piece=5000):
    """Return all estimates as columns."""
    rows = [r for k in range(0, len(data), piece) for r in watch.feed(data[k : k + piece])]
    return {name: np.concatenate([r.columns[name] for r in rows]) for name in rows[0].columns}


@pytest.fixture
def watch(tmp_path):
    def make(machine="servo-400w", **options):
        return Watch(fluxobs.read_machine(machine), tmp_path / "stream", **options)

    return make


@pytest.mark.parametrize(("unknowns", "pieces"), [("auto", 333), ("drift", len(DEMO))])
def test_the_estimates_of_a_log(watch, unknowns, pieces):
    live, repeated = watch(unknowns=unknowns), watch(unknowns=unknowns)
    estimates = watched(live, DEMO)
    in_pieces = watched(repeated, DEMO, pieces)
    for name in estimates:
        assert np.array_equal(estimates[name], in_pieces[name], equal_nan=True), name
    assert len(estimates["t"]) == live.status.rows == 10_000
    log = fluxobs.estimate(
        fluxobs.demo_log(),
        "servo-400w",
        unknowns=unknowns if unknowns != "auto" else live.unknowns,
        causal=True,
    )
    # only the scales of the signals differ, which a stream cannot know in advance
    both = estimates["valid"] & log["valid"]
    assert both.sum() > 0.95 * log["valid"].sum()
    difference = np.abs(estimates["theta_e"] - log["theta_e"])[both]
    assert (np.minimum(difference, 2 * np.pi - difference) < log["theta_e_std"][both]).all()
    rms = [
        np.degrees(np.sqrt(np.mean(e[both] ** 2)))
        for e in (estimates["theta_e_error"], log["theta_e_error"])
    ]
    assert rms[0] < 1.3 * rms[1] + 0.05


def test_missing_rows_are_bad_samples(watch):
    header, *rows = DEMO.splitlines(keepends=True)
    del rows[5000:5003], rows[7000:7060]
    live = watch()
    estimates = watched(live, header + b"".join(rows))
    assert live.status.lost == 63
    assert np.allclose(np.diff(estimates["t"]), 2e-4)
    assert not estimates["valid"][5001]
    error = np.degrees(np.abs(estimates["theta_e_error"][estimates["valid"]]))
    assert error.max() < 1.5


def test_it_waits_for_a_current(watch):
    header, *rows = DEMO.splitlines(keepends=True)
    still = [b"%.4f,0,0,0,0,0\n" % (2e-4 * k) for k in range(12_000)]
    moved = [b"%.4f," % (2.4 + 2e-4 * k) + row.split(b",", 1)[1] for k, row in enumerate(rows)]
    live = watch()
    assert list(live.feed(header + b"".join(still))) == []
    assert "current is zero" in live.status.waiting
    estimates = watched(live, b"".join(moved))
    assert live.status.waiting == ""
    assert estimates["valid"][-100:].all()


def test_a_signal_that_grows_gets_an_observer_that_fits(watch):
    """The first observer is chosen near standstill and does not fit the full speed that follows."""
    header, *rows = DEMO.splitlines(keepends=True)
    table = np.array([[float(x) for x in row.split(b",")] for row in rows])
    quiet = np.repeat(table[:1], 5000, 0)
    quiet[:, 1:5] = 1e-3 * np.random.default_rng(1).normal(size=(5000, 4))
    quiet[:, 0] = 2e-4 * np.arange(5000)
    table[:, 0] += 1.0
    data = header + b"".join(
        b",".join(b"%.6g" % x for x in row) + b"\n" for row in np.concatenate([quiet, table])
    )
    live = watch()
    estimates = watched(live, data)
    assert live.status.chosen > 1
    assert estimates["valid"][-4000:].mean() > 0.9
    assert np.degrees(np.abs(estimates["theta_e_error"][estimates["valid"]])).max() < 3


def test_a_recording_is_a_log(watch, tmp_path):
    live, recorded = watch(), []
    for k in range(0, 300_000, 4000):
        if k == 120_000:
            live.record(recorded.append)
        for _ in live.feed(DEMO[k : k + 4000]):
            pass
    path = tmp_path / "recorded.csv"
    path.write_bytes(b"".join(recorded))
    log = fluxobs.read_log(path)
    assert len(log) > 3000
    rows = {line.split(b",")[0]: line for line in DEMO.splitlines()}
    assert all(rows[line.split(b",")[0]] == line for line in path.read_bytes().splitlines())


@pytest.mark.parametrize(
    ("data", "options", "message"),
    [
        (DEMO.replace(b"u_alpha", b"foo", 1), {}, "u_alpha"),
        (b"\n".join(line.split(b",", 1)[1] for line in DEMO.splitlines()), {}, "sample_time"),
        (DEMO, {"unknowns": "speed"}, "unknown"),
        (DEMO, {"memory": 1e-5}, "memory"),
        (DEMO, {"memory": np.nan}, "memory must be a positive"),
        (DEMO, {"frame": "bogus"}, "frame"),
    ],
)
def test_what_cannot_be_estimated_is_refused(watch, data, options, message):
    with pytest.raises(FluxobsError, match=message):
        watched(watch(**options), data)


def test_a_stream_in_frames(watch):
    rows = np.array([[float(x) for x in line.split(b",")] for line in DEMO.splitlines()[1:]])
    names = b"2e-4,0,u_alpha,u_beta,i_alpha,i_beta,theta_e"
    data = frame(HEADER, 0, names) + b"".join(
        frame(SAMPLES, k, row[1:].astype("<f4").tobytes()) for k, row in enumerate(rows)
    )
    text, framed = watched(watch(), DEMO), watched(watch(), data)
    assert np.allclose(text["t"], framed["t"])
    difference = np.abs(text["theta_e"] - framed["theta_e"])
    difference = np.minimum(difference, 2 * np.pi - difference)
    both = text["valid"] & framed["valid"]
    assert (difference < text["theta_e_std"])[both].all()


def test_a_short_stream_is_estimated_when_it_ends(watch):
    live = watch(lag=1)
    data = b"".join(DEMO.splitlines(keepends=True)[:1001]).rstrip(b"\n")
    assert list(live.feed(data)) == []
    rows = list(live.feed(b"", last=True))
    assert sum(len(batch.valid) for batch in rows) == live.status.rows == 1000


def test_an_empty_stream_is_no_error(watch):
    live = watch()
    assert list(live.feed(b"", last=True)) == []
    assert "first 2000 rows" in live.status.waiting


def test_names_that_come_later(watch):
    header, rows = DEMO.split(b"\n", 1)
    live = watch()
    assert list(live.feed(rows)) == []
    assert "a line that names the columns, not found in 9990 lines" in live.status.waiting
    with pytest.raises(FluxobsError, match="expected a header"):
        list(watch().feed(rows, last=True))
    estimates = [*live.feed(header + b"\n" + rows[:100_000]), *live.feed(rows[100_000:])]
    assert sum(len(batch.valid) for batch in estimates) == 10_000


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
    recorded, data = [], FIRST + b"".join(lines)
    live = watch()
    live.record(recorded.append)
    estimates = watched(live, data)
    list(live.feed(b"", last=True))
    path = tmp_path / "recorded.csv"
    path.write_bytes(b"".join(recorded))
    log = fluxobs.read_log(path, sample_time=2e-4)
    assert abs(len(log) - 10_000) <= 2
    assert live.status.lost <= 2
    error = np.degrees(np.abs(estimates["theta_e_error"][estimates["valid"]]))
    assert error.max() < 6
    assert estimates["valid"].mean() > 0.8


def test_received_bytes_are_kept_until_there_are_rows(watch):
    live = watch()
    live.record(lambda lines: None)
    list(live.feed(LINES[0] * 3000))
    assert live.unread == LINES[0] * 3000
    list(live.feed(DEMO))
    assert live.unread == b""


@pytest.mark.parametrize("grown", ["u", "i"])
@pytest.mark.parametrize(("factor", "chosen"), [(3.4, 1), (4.8, 2)])
def test_four_times_the_first_signals_need_another_observer(watch, grown, factor, chosen):
    """An observer is chosen for twice the measured signals; above four times, another is chosen."""
    t = 2e-4 * np.arange(15_000)
    vector = np.exp(1j * 300 * t)
    large = np.where(t > 1.5, factor, 1.0)
    sizes = {name: (large if name == grown else 1.0) for name in ("u", "i")}
    voltage, current = 4 * sizes["u"] * 1j * vector, 2 * sizes["i"] * vector
    table = np.stack([t, voltage.real, voltage.imag, current.real, current.imag], axis=1)
    lines = ["t,u_alpha,u_beta,i_alpha,i_beta", *(",".join(f"{x:.7g}" for x in r) for r in table)]
    live = watch(unknowns="drift")
    watched(live, "\n".join(lines).encode() + b"\n")
    assert live.status.chosen == chosen
