"""Rows from the bytes of a stream, text or frames, in chunks of any size."""

import subprocess
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fluxobs
from fluxobs.errors import RecordError
from fluxobs.live.even_rows import Spaced
from fluxobs.live.frames import HEAD_ROWS, HEADER, MARK, SAMPLES, Frames, frame
from fluxobs.live.lines import HEAD_LINES, Lines
from fluxobs.live.reorder import Order, Ordered
from fluxobs.live.rows import StreamRows
from fluxobs.logs.time.clock import even
from support.records import MACHINES

NAMES = ("u_alpha", "u_beta", "i_alpha", "i_beta")


def whole(batches):
    """Return the columns of all batches."""
    return {name: np.concatenate([b.columns[name] for b in batches]) for name in batches[0].columns}


def unwrapped(t):
    """Return the times of frames whose number wraps once."""
    return np.where(t < t[0], t + 65536 * 1e-4, t)


def in_pieces(data, cuts):
    return [data[a:b] for a, b in pairwise([0, *sorted(cuts), len(data)])]


def framed(rows, first=65000, names=NAMES, again=1000):
    """Return rows as frames, with a header after every `again` rows."""
    stream = bytearray()
    for n, row in enumerate(np.asarray(rows, "<f4")):
        if n % again == 0:
            stream += frame(HEADER, first + n, ",".join(["0.0001", "1", *names]).encode())
        stream += frame(SAMPLES, first + n, row.tobytes())
    return bytes(stream)


ROWS = np.random.default_rng(1).normal(size=(3 * HEAD_ROWS, 4)).astype("<f4")


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, len(framed(ROWS))), max_size=30))
def test_frames_come_in_any_pieces(cuts):
    frames = Frames()
    batches = [rows for piece in in_pieces(framed(ROWS), cuts) for rows in frames.feed(piece)]
    columns = whole(batches)
    assert np.array_equal(np.stack([columns[name] for name in NAMES], 1), ROWS.astype(float))
    assert np.allclose(np.diff(unwrapped(columns["t"])), 1e-4)
    assert frames.damaged == 0
    assert frames.layout == {"sample_time": 1e-4, "lag": 1.0}


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.integers(60, 60_000), st.integers(1, 255)), max_size=20))
def test_damaged_frames_are_left_out_and_the_others_stay_at_their_times(damages):
    data = bytearray(framed(ROWS))
    for at, change in damages:
        data[at] ^= change
    frames = Frames()
    columns = whole(frames.feed(bytes(data)))
    row = np.round(unwrapped(columns["t"]) / 1e-4).astype(int)
    row -= row[-1] - (len(ROWS) - 1)
    assert np.array_equal(columns["i_beta"], ROWS[row, 3].astype(float))
    assert len(ROWS) - len(row) <= 3 * len(damages)  # a damaged length swallows more than one row


def test_bytes_between_frames_are_skipped():
    data = b"boot\r\n" + MARK + b"x" + framed(ROWS) + MARK
    columns = whole(Frames().feed(data))
    assert np.array_equal(columns["u_beta"], ROWS[:, 1].astype(float))


def test_samples_before_the_header_are_skipped():
    data = framed(ROWS, again=700)
    columns = whole(Frames().feed(data[data.index(MARK, 40) :]))
    assert len(columns["t"]) == len(ROWS) - 700


@pytest.mark.parametrize(
    ("second", "message"), [(b"1e-4,1,a,b", "changed"), (b"fast,1,a,b", "must begin with")]
)
def test_a_malformed_header_is_refused(second, message):
    frames = Frames()
    if message == "changed":
        frames.feed(frame(HEADER, 0, b"1e-4,1,u,i"))
    with pytest.raises(RecordError, match=message):
        frames.feed(frame(HEADER, 0, second))


@pytest.mark.slow
def test_the_telemetry_of_an_export_is_read(tmp_path):
    fluxobs.export(MACHINES["servo-400w"], 5e-5, tmp_path / "motor", unknowns="drift")
    main = tmp_path / "main.c"
    main.write_text("""
        #include <stdio.h>
        #include "telemetry.h"
        int main(void)
        {
            unsigned char out[TELEMETRY_MOST];
            for (uint32_t k = 65000U; k < 70000U; k++) {
                const float voltage[2] = {(float)k, -0.1f}, current[2] = {1e-30f, 3.5f};
                if (k % 1000U == 0U) {
                    (void)fwrite(out, 1, telemetry_names(out, k), stdout);
                }
                if (k % 7U != 0U) { /* some are lost */
                    (void)fwrite(out, 1, telemetry_sample(out, k, voltage, current), stdout);
                }
            }
            return 0;
        }""")
    options = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic"]
    sources = [main, tmp_path / "motor" / "telemetry.c"]
    subprocess.run(
        ["cc", *options, f"-I{tmp_path / 'motor'}", *sources, "-o", tmp_path / "send"], check=True
    )
    sent = subprocess.run([tmp_path / "send"], check=True, capture_output=True).stdout
    frames = Frames()
    columns = whole(frames.feed(sent))
    k = np.array([k for k in range(65000, 70000) if k % 7])
    assert np.array_equal(columns["u_alpha"], k)
    assert np.allclose(columns["t"], 5e-5 * (k % 65536), rtol=1e-12)
    assert set(columns["u_beta"]) == {np.float32(-0.1)}
    assert set(columns["i_alpha"]) == {np.float32(1e-30)}
    assert frames.layout == {"sample_time": 5e-5, "lag": 1.0}
    assert frames.damaged == 0


def lines_of(rows, header="t,u_alpha,u_beta,i_alpha,i_beta"):
    return "".join([header + "\n", *(",".join(f"{v:.9g}" for v in row) + "\n" for row in rows)])


def recorded(lines, batches):
    """Return the recording of rows that are in order."""
    ordered = [Ordered(b, b.columns["t"], np.zeros(b.rows)) for b in batches]
    return b"".join([lines.recorded(rows, "t", n == 0) for n, rows in enumerate(ordered)])


TIMED = np.column_stack([1e-4 * np.arange(len(ROWS)), ROWS])
TEXT = lines_of(TIMED).encode()


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, len(TEXT)), max_size=20))
def test_lines_come_in_any_pieces(tmp_path_factory, cuts):
    lines = Lines(tmp_path_factory.mktemp("head") / "stream")
    batches = [rows for piece in in_pieces(TEXT, cuts) for rows in lines.feed(piece)]
    columns = whole(batches)
    assert np.array_equal(columns["i_beta"], ROWS[:, 3].astype(float).round(9)) or np.allclose(
        columns["i_beta"], ROWS[:, 3], rtol=1e-8
    )
    assert recorded(lines, batches) == TEXT


def test_a_stream_that_is_joined_midway(tmp_path):
    header, *rows = TEXT.decode().splitlines(keepends=True)
    rows.insert(300, header)
    joined = "".join(rows)[17:].encode()  # within a line
    columns = whole(Lines(tmp_path / "stream").feed(joined, last=True))
    assert np.array_equal(columns["t"], TIMED[300:, 0].round(12))


def test_a_header_between_rows_comments_and_blank_lines_are_no_rows(tmp_path):
    header, *rows = TEXT.decode().splitlines(keepends=True)
    lines = Lines(tmp_path / "stream")
    first = whole(lines.feed((header + "".join(rows[:HEAD_LINES])).encode()))
    more = ["# hello\n", "\n", header, *rows[HEAD_LINES:], header]
    columns = whole(lines.feed("".join(more).encode()))
    assert len(first["t"]) + len(columns["t"]) == len(rows)
    assert np.isfinite(columns["t"]).all()
    assert lines.damaged == 0


def test_damaged_lines_are_counted_and_keep_their_place(tmp_path):
    header, *rows = TEXT.decode().splitlines(keepends=True)
    lines = Lines(tmp_path / "stream")
    lines.feed((header + "".join(rows[:HEAD_LINES])).encode())
    bad = ["1,2,3,4,5,6,7\n", 'x"y\n', "12.5\n", "\xff\xfe,1,2,3,4\n"]
    columns = whole(lines.feed("".join([*bad, *rows[-3:]]).encode("latin-1")))
    assert len(columns["t"]) == 7
    assert np.isnan(columns["i_beta"][:3]).all()
    assert np.isnan(columns["t"][:3]).all()
    assert np.isfinite(columns["i_beta"][-3:]).all()
    assert lines.damaged == 3  # in the fourth line, only one cell is not a number


def test_names_given_for_a_stream_without_header(tmp_path):
    rows = TEXT.split(b"\n", 1)[1]
    lines = Lines(tmp_path / "stream", "t, u_alpha, u_beta, i_alpha, i_beta")
    batches = lines.feed(rows)
    assert list(batches[0].columns) == ["t", *NAMES]
    assert recorded(lines, batches).startswith(b"t, u_alpha, u_beta, i_alpha, i_beta\n")


def spaced(stamps, clock=None):
    """Return counts and evenly spaced rows; check that all rows at once and single rows agree."""
    clock = clock or even(100, 0.01)
    stamps = np.asarray(stamps, float)
    rows = StreamRows({"t": stamps, "i": np.arange(len(stamps), dtype=float)}, b"")
    pieces = [rows.at(np.arange(len(stamps)) == k) for k in range(len(stamps))]
    outcomes = []
    for batches in ([rows], pieces):
        order, even_rows = Order(clock, "t", 1.0, 0.0), Spaced(clock)
        ordered = [*(order.add(batch) for batch in batches), order.end()]
        filled = [even_rows.add(o.received.columns, o.t) for o in ordered if o.received.rows]
        columns = {name: np.concatenate([f[name] for f in filled]) for name in ("t", "i")}
        moved = np.concatenate([o.moved for o in ordered])
        counts = (even_rows.lost, order.restarts, order.left_out)
        outcomes.append((counts, columns, moved))
    (counts, columns, moved), (row_counts, row_columns, row_moved) = outcomes
    assert np.array_equal(columns["i"], row_columns["i"], equal_nan=True)
    assert np.array_equal(columns["t"], row_columns["t"])
    assert np.array_equal(moved, row_moved)
    assert counts == row_counts
    return counts, columns


NAN = np.nan


def test_gaps_are_filled_with_nan():
    counts, columns = spaced([0, 0.01, 0.02, 0.05, 0.06, 0.16])
    assert np.allclose(np.diff(columns["t"]), 0.01)
    assert counts == (2 + 9, 0, 0)
    assert np.array_equal(columns["i"], [0, 1, 2, NAN, NAN, 3, 4, *[NAN] * 9, 5], equal_nan=True)


def test_time_continues_when_the_sender_restarts():
    counts, columns = spaced([5.0, 5.01, 5.02, 0.0, 0.01])
    assert counts == (1, 1, 0)
    assert np.allclose(columns["t"], 5.0 + 0.01 * np.arange(6))
    assert np.isnan(columns["i"][3])


@pytest.mark.parametrize(
    ("stamps", "numbers", "counts"),
    [
        ([0, 1, 1, 2, 2, 2, 3], [0, 1, 3, 6], (0, 0, 3)),  # twice
        ([0, 1, 3, 2, 4, 5], [0, 1, 3, NAN, 4, 5], (1, 0, 1)),  # two swapped: one is late
        ([0, 1, 2, 3, 1, 4, 5], [0, 1, 2, 3, 5, 6], (0, 0, 1)),  # late
        ([0, 1, 2, 1.8e21, 4, 5], [0, 1, 2, NAN, 4, 5], (1, 0, 1)),  # damaged
        ([0, 1, 2, 30, 4, 5], [0, 1, 2, NAN, 4, 5], (1, 0, 1)),
        ([0, 1, 2, NAN, 4, 5], [0, 1, 2, NAN, 4, 5], (1, 0, 1)),
        ([70, 1, 2, 3], [1, 2, 3], (0, 0, 1)),  # the first of all
        ([0, 1, 2, 30], [0, 1, 2, *[NAN] * 27, 3], (27, 0, 0)),  # a gap at the end
        ([0, 1, 2, 3, 0], [0, 1, 2, 3], (0, 0, 1)),
        ([0, 1, 2, 30, 32, 33], [0, 1, 2, *[NAN] * 27, 3, NAN, 4, 5], (28, 0, 0)),
        ([0, 1, 2, 30, 0, 1, 2], [0, 1, 2, NAN, 4, 5, 6], (1, 1, 1)),
        ([0, 1, 2, 1e8, 1e8 + 1, 1e8 + 2], [0, 1, 2, NAN, 3, 4, 5], (1, 1, 0)),
    ],
)
def test_rows_out_of_order_are_left_out(stamps, numbers, counts):
    actual, columns = spaced(0.01 * np.array(stamps))
    assert actual == counts
    assert np.array_equal(columns["i"], numbers, equal_nan=True)
    assert np.allclose(np.diff(columns["t"]), 0.01)


def wrapping(wrap):
    clock = even(100, 0.01)
    return type(clock)(**{**vars(clock), "wrap": wrap})


def test_time_continues_when_a_counter_wraps():
    counts, columns = spaced(0.01 * np.arange(40) % 0.16, wrapping(0.16))
    assert counts == (0, 0, 0)
    assert np.allclose(columns["t"], 0.01 * np.arange(40))


def test_rows_out_of_order_where_a_counter_wraps():
    number = np.array([14, 15, 15, 17, 16, 18, 19, 16, 20, 33, 34])
    counts, columns = spaced(0.01 * (number % 32), wrapping(0.32))
    assert counts == (1 + 12, 0, 3)
    assert np.allclose(columns["t"], 0.01 * np.arange(14, 35))


def test_a_long_gap_is_shortened():
    counts, columns = spaced([0, 0.01, 1e4, 1e4 + 0.01])
    assert counts[0] > 900_000
    assert len(columns["t"]) < 20_000
    assert columns["t"][-2] == pytest.approx(1e4)


def test_rounded_stamps_make_no_gaps():
    clock = even(100, 0.01)
    clock = type(clock)(**{**vars(clock), "rounding": 0.05})
    counts, _ = spaced(np.floor(0.01 * np.arange(200) / 0.05) * 0.05, clock)
    assert counts == (0, 0, 0)


def test_columns_separated_by_several_spaces(tmp_path):
    data = TEXT.replace(b",", b"   ").replace(b"\n", b"  \n ")
    lines = Lines(tmp_path / "stream")
    batches = [b for k in range(0, len(data), 50_001) for b in lines.feed(data[k : k + 50_001])]
    assert np.allclose(whole(batches)["i_beta"][: len(ROWS)], ROWS[:, 3], rtol=1e-8)
    assert lines.damaged == 0


FIRST = TEXT.splitlines(keepends=True)


def with_line(at, line):
    return [*FIRST[:at], line, *FIRST[at:]]


@pytest.mark.parametrize(
    ("lines", "damaged", "missing"),
    [
        (with_line(1000, b"1,2\n"), 1, 0),
        (with_line(1000, b"1,2,3,4,5,6,7\n"), 1, 0),
        (with_line(1000, b"\x00\x01,\xff,,\n"), 1, 0),
        ([*FIRST[:1000], FIRST[1000].replace(b",", b",b", 1), *FIRST[1001:]], 1, 1),
        (with_line(0, b"boot \x00\x07\n"), 1, 0),
        (with_line(1, b"WARN,overtemp,phase\n"), 1, 0),
        (with_line(1000, b"WARN,overtemp,phase\n"), 1, 0),
        (with_line(1000, FIRST[0]), 0, 0),
        (with_line(1, b"s,V,V,A,A\n"), 0, 0),
        ([b"# rig 3\n", b"# phases in order\n", *FIRST], 0, 0),
    ],
)
def test_damaged_first_lines(tmp_path, lines, damaged, missing):
    """Damaged first lines are left out, for chunks of any size."""
    for piece in (len(TEXT) + 1000, 7001):
        reader = Lines(tmp_path / "stream")
        data = b"".join(lines)
        batches = [b for k in range(0, len(data), piece) for b in reader.feed(data[k : k + piece])]
        columns = whole(batches)
        assert list(columns) == ["t", *NAMES]
        assert len(columns["t"]) == len(ROWS) - missing
        assert np.isfinite(columns["i_beta"]).all()
        assert reader.damaged == damaged


def test_any_line_ends(tmp_path):
    for end in (b"\r", b"\r\n"):
        reader, data = Lines(tmp_path / "stream"), TEXT.replace(b"\n", end)
        batches = [b for k in range(0, len(data), 5003) for b in reader.feed(data[k : k + 5003])]
        batches += reader.feed(b"", last=True)
        assert np.array_equal(whole(batches)["t"], TIMED[:, 0].round(9))


def test_bytes_without_lines_are_refused(tmp_path):
    with pytest.raises(RecordError, match="without the end of a line"):
        Lines(tmp_path / "stream").feed(b"x" * 1_100_000)


def test_other_columns_than_before_are_refused(tmp_path):
    reader = Lines(tmp_path / "stream")
    reader.feed(TEXT)
    assert len(reader.feed(b"a,b,c\n" + FIRST[1])) == 1  # not a line of names
    with pytest.raises(RecordError, match=r"changed from t,u_alpha,.* to t,i_alpha,"):
        reader.feed(b"t,i_alpha,i_beta,u_alpha,u_beta\n")


def test_several_samples_of_a_frame_are_numbered_modulo_65536():
    names = frame(HEADER, 0, b"0.5,1,u,i")
    payload = np.arange(8, dtype="<f4").tobytes()
    (rows,) = Frames().feed(names + frame(SAMPLES, 65534, payload), last=True)
    assert rows.columns["t"].tolist() == [32767.0, 32767.5, 0.0, 0.5]
    assert rows.columns["u"].tolist() == [0, 2, 4, 6]
    assert rows.columns["i"].tolist() == [1, 3, 5, 7]


def test_each_damaged_frame_is_counted_once():
    names, intact = frame(HEADER, 0, b"0.5,1,u,i"), frame(SAMPLES, 1, bytes(8))
    wrong = intact[:-1] + bytes([intact[-1] ^ 1])
    frames = Frames()
    short = frame(SAMPLES, 2, bytes(12))  # one and a half samples
    batches = frames.feed(names + wrong + intact + short + wrong + short, last=True)
    assert frames.damaged == 4
    assert whole(batches)["t"].tolist() == [0.5]


def test_rows_are_held_back_until_there_are_enough_to_begin():
    names = frame(HEADER, 0, b"0.5,1,u,i")
    rows = [frame(SAMPLES, k, bytes(8)) for k in range(HEAD_ROWS + 1)]
    frames = Frames()
    assert frames.feed(names + b"".join(rows[: HEAD_ROWS - 1])) == []
    assert len(whole(frames.feed(rows[HEAD_ROWS - 1]))["t"]) == HEAD_ROWS
    assert len(whole(frames.feed(rows[HEAD_ROWS]))["t"]) == 1
