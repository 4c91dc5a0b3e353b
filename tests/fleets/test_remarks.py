"""Remarks on the drives of a fleet equal closed forms; limits are tested on both sides."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

from fluxobs.errors import UsageError
from fluxobs.fleets.batch import Fleet
from fluxobs.fleets.changes import Course, Segment
from fluxobs.fleets.follow import (
    FOLLOWED,
    YEAR,
    Followed,
    Limit,
    _jump_remarks,
    _limit_remarks,
    _mark_unlike,
    _trend_remarks,
    describe_too_few,
    describe_undated,
    follow,
    read_limit,
    untold,
)
from fluxobs.fleets.log_task import COLUMNS
from fluxobs.fleets.report import DRAWN, headline, picture, remarks, write_html
from fluxobs.fleets.sources import ELSEWHERE, Source, shared, sources

START = datetime(2024, 1, 1, tzinfo=UTC)
LEVEL = Course((Segment(0, 4, 1.0, 0.1),), 0.0, 0.0, np.inf)


def followed(drive="a", name="resistance", course=LEVEL, **fields) -> Followed:
    """Return one parameter over four daily logs."""
    times = [START + timedelta(days=k) for k in range(4)]
    logs = [f"{drive}/{k}.csv" for k in range(4)]
    defaults = {"limits": None, "remarks": (), "crossed": False}
    level = np.full(4, course.segments[-1].mean)
    return Followed(drive, name, times, logs, level, np.full(4, 0.1), course, **defaults | fields)


def rows(*values: dict) -> pl.DataFrame:
    return pl.DataFrame([dict.fromkeys(COLUMNS) | row for row in values], schema=COLUMNS)


@pytest.mark.parametrize(
    ("value", "std", "beyond"),
    [(3.19, 0.1, False), (3.21, 0.1, True), (1.81, 0.1, False), (1.79, 0.1, True)],
)
def test_a_limit_is_crossed_beyond_two_deviations(value, std, beyond):
    texts = _limit_remarks("resistance", ["x"], np.array([value]), np.array([std]), (2.0, 3.0))
    assert bool(texts) == beyond
    if beyond:
        assert texts == [f"resistance {value:g} Ω is outside 2 Ω to 3 Ω in x"]


def test_a_remark_names_the_first_crossing_and_counts_the_others():
    values = np.array([2.5, 5.0, 2.5, 6.0, 7.0])
    logs = list("abcde")
    (text,) = _limit_remarks("resistance", logs, values, np.zeros(5), (2.0, 3.0))
    assert text == "resistance 5 Ω is outside 2 Ω to 3 Ω in b and 2 more logs"
    (text,) = _limit_remarks("resistance", logs[:3], values[:3], np.zeros(3), (2.0, 3.0))
    assert text.endswith("in b")


def step(before: float, after: float) -> Course:
    return Course((Segment(0, 3, before, 0.3), Segment(3, 4, after, 0.4)), 0.0, 0.0, np.inf)


@pytest.mark.parametrize(
    ("name", "before", "after", "text"),
    [
        (
            "resistance",
            *(10.0, 12.0),
            "resistance changed by +2 Ω ± 500 mΩ (+20.0 %), like +51 K of copper, between c and d "
            "(2024-01-04)",
        ),
        (
            "resistance",
            *(10.0, 9.0),
            "resistance changed by -1 Ω ± 500 mΩ (-10.0 %), like -25 K of copper, between c and d "
            "(2024-01-04)",
        ),
        (
            "psi_f",
            *(4.0, 3.0),
            "magnet flux changed by -1 Wb ± 500 mWb (-25.0 %), between c and d (2024-01-04)",
        ),
        (
            "offset_alpha",
            *(4.0, 3.0),
            "current offset α changed by -1 A ± 500 mA, between c and d (2024-01-04)",
        ),
        (
            "inverter_voltage",
            *(-1.0, 3.0),
            "inverter's voltage loss changed by +4 V ± 500 mV, between c and d (2024-01-04)",
        ),
        (
            "resistance",
            *(0.0, 3.0),
            "resistance changed by +3 Ω ± 500 mΩ, between c and d (2024-01-04)",
        ),
    ],
)
def test_a_jump_in_words(name, before, after, text):
    """Copper gains 0.393 % per kelvin."""
    assert _jump_remarks(name, list("abcd"), followed().times, step(before, after)) == [text]


def test_share_of_a_value_below_one():
    (text,) = _jump_remarks("resistance", list("abcd"), followed().times, step(0.5, 1.5))
    assert "(+200.0 %), like +509 K of copper" in text


T = np.array([when.timestamp() for when in followed().times])


def drifting(slope: float, std: float = 1e-12) -> Course:
    """Return a course with this trend per year that passes 1.0 in the middle of four days."""
    return Course((Segment(0, 4, 1.0, 0.1),), 0.0, slope / YEAR, std)


def test_without_a_trend_there_is_no_remark():
    assert _trend_remarks("psi_f", T, LEVEL, (0.0, 2.0)) == []


def test_a_trend_in_words():
    texts = _trend_remarks("psi_f", T, drifting(-0.25, 0.01 / YEAR), None)
    assert texts == ["magnet flux drifts by -250 mWb ± 10 mWb per year"]


@pytest.mark.parametrize(
    ("slope", "bounds", "month"),
    [
        (0.5, (0.0, 2.0), "January 2026"),
        (-0.5, (0.0, 2.0), "January 2026"),
        (0.5, (0.0, 1.5), "January 2025"),
        (1.0, (0.0, 5.95), "December 2028"),
        (1.0, (0.0, 6.05), None),  # in more than five years
        (1.0, (0.0, 0.9), None),  # already outside
        (-1.0, (1.1, 2.0), None),
    ],
)
def test_when_a_trend_reaches_its_limit(slope, bounds, month):
    (text,) = _trend_remarks("psi_f", T, drifting(slope), bounds)
    if month is None:
        assert "reach" not in text
    else:
        assert text.endswith(f"per year; it will reach the limit in {month}")


def test_the_trend_is_extrapolated_from_the_end_of_the_last_segment():
    """The last six of ten days have a trend of 0.1 per day around 1.0: 1.25 on the last day."""
    t = START.timestamp() + 86400.0 * np.arange(10)
    slope = 0.1 / 86400
    course = Course((Segment(0, 4, 5.0, 0.1), Segment(4, 10, 1.0, 0.1)), 0.0, slope, 1e-12)
    (text,) = _trend_remarks("psi_f", t, course, (0.0, 1.25 + 0.1 * 25))  # 25 days after January 10
    assert text.endswith("February 2024")
    (text,) = _trend_remarks("psi_f", t, course, (0.0, 1.25 + 0.1 * 20))
    assert text.endswith("January 2024")


def test_first_level_and_level_now():
    drifting_item = followed(course=drifting(0.5))
    change = 0.5 * 3 * 86400 / YEAR
    assert drifting_item.first == pytest.approx(1 - change / 2, rel=1e-9)
    assert drifting_item.level == pytest.approx(1 + change / 2, rel=1e-9)
    steps = Course((Segment(0, 2, 3.0, 0.1), Segment(2, 4, 1.0, 0.1)), 0.0, 0.5 / YEAR, 1e-12)
    stepped_item = followed(course=steps)
    assert stepped_item.first == 3.0
    assert stepped_item.level == pytest.approx(1 + change / 3 / 2, rel=1e-9)
    assert (followed().first, followed().level, followed().unit) == (1.0, 1.0, "Ω")


LEVELS = (1.0, 1.1, 0.9, 1.2)


def fleet_of(outlier: float, std: float) -> list[Followed]:
    return [
        followed(str(k), course=Course((Segment(0, 4, x, std),), 0.0, 0.0, np.inf))
        for k, x in enumerate((*LEVELS, outlier))
    ]


@pytest.mark.parametrize(("deviations", "unlike"), [(4.95, False), (5.05, True)])
@pytest.mark.parametrize("std", [0.0, 0.2])
def test_a_drive_differs_beyond_five_deviations(deviations, unlike, std):
    """The median is 1.1, the median absolute deviation 0.1, the standard deviation 0.14826."""
    outlier = 1.1 + deviations * np.hypot(0.14826, std)
    remarks_of_drives = [item.remarks for item in _mark_unlike(fleet_of(outlier, std))]
    assert remarks_of_drives[:4] == [()] * 4
    assert bool(remarks_of_drives[4]) == unlike
    if unlike:
        assert remarks_of_drives[4][0].endswith("differs from the other drives (1.1 Ω ± 148 mΩ)")


def test_four_or_equal_drives_do_not_differ():
    drives = fleet_of(100.0, 0.1)
    assert all(not drive.remarks for drive in _mark_unlike(drives[1:]))
    same = [replace(drive, course=Course((Segment(0, 4, 1, 0),), 0, 0, np.inf)) for drive in drives]
    assert all(not drive.remarks for drive in _mark_unlike(same))


def test_the_remark_on_a_different_drive_comes_last():
    drives = fleet_of(100.0, 0.0)
    drives[4] = replace(drives[4], remarks=("before",))
    assert _mark_unlike(drives)[4].remarks[0] == "before"
    assert len(_mark_unlike(drives)[4].remarks) == 2


def test_bounds_of_a_drive():
    assert Limit("psi_f", 1.0, 2.0, relative=False).of(5.0) == (1.0, 2.0)
    assert Limit("psi_f", -0.1, 0.2, relative=True).of(5.0) == pytest.approx((4.5, 6.0))
    assert Limit("offset_alpha", -0.1, 0.2, relative=True).of(-5.0) == pytest.approx((-6, -4.5))


@pytest.mark.parametrize("text", ["psi_f=1..1", "psi_f=0%", "psi_f=-10%", "psi_f=5..4%"])
def test_bounds_must_be_ascending(text):
    with pytest.raises(UsageError, match="LOW must be below HIGH"):
        read_limit(text)


def test_a_limit_allows_for_the_scatter_of_the_drive():
    """In a zigzag of ±0.1 with small stds, only the scatter crosses the limit."""
    logs = [
        {
            "log": str(k),
            "drive": "a",
            "time": START + timedelta(days=k),
            "resistance": 1 + 0.1 * (-1) ** k,
            "resistance_std": 1e-4,
        }
        for k in range(20)
    ]
    inside, beyond = (
        follow(rows(*logs), [Limit("resistance", 0.0, upper, relative=False)])[0]
        for upper in (1.0, 0.3)
    )
    assert not inside.crossed
    assert inside.course.scatter > 0.06
    assert beyond.crossed
    assert beyond.remarks[0].endswith("in 0 and 19 more logs")


def test_only_identified_values_are_followed():
    log = {"log": "x", "drive": "a", "time": START, "resistance": 1.0, "resistance_std": 0.1}
    for change, count in (
        ({}, 1),
        ({"resistance_std": 0.0}, 0),
        ({"resistance_std": np.inf}, 0),
        ({"resistance": np.nan}, 0),
        ({"failed": "no"}, 0),
        ({"time": None}, 0),
        ({"drive": None}, 1),
    ):
        assert len(follow(rows(log | change))) == count


def test_parameters_are_in_the_order_of_the_list():
    log = {"log": "x", "drive": "b", "time": START}
    for name, (std, _, _) in FOLLOWED.items():
        log |= {name: 1.0, std: 0.1}
    items = follow(rows(log, log | {"drive": "a"}))
    assert [(item.drive, item.name) for item in items] == [(d, n) for d in "ab" for n in FOLLOWED]


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (0, ""),
        (
            1,
            "1 log has no time and is ignored: write a date like 2024-05-17 into the name.",
        ),
        (
            2,
            "2 logs have no time and are ignored: write a date like 2024-05-17 into the name.",
        ),
    ],
)
def test_logs_without_a_time(count, text):
    timed, failed = {"time": START}, {"failed": "no columns"}
    assert describe_undated(rows(timed, failed, *[{}] * count)) == text


def test_changes_need_six_logs_of_a_drive():
    log, failed = {"drive": "a"}, {"drive": "a", "failed": "no columns"}
    assert describe_too_few(rows(*[log] * 6, failed)) == ""
    text = describe_too_few(rows(*[log] * 5, {"drive": "b"}, failed))
    assert text.startswith("No drive has more than 5 logs; finding changes needs 6 logs. ")
    assert describe_too_few(rows(failed)).startswith("No drive has more than 0 logs")


def test_limits_on_unidentified_parameters():
    limits = [read_limit("resistance=10%"), read_limit("psi_f=10%")]
    assert untold([followed()], limits) == [
        "limit on magnet flux: no log identifies this parameter"
    ]


@pytest.mark.parametrize(
    ("drives", "marked", "start"),
    [
        (1, 0, "6 logs of 1 drive, 2024-01-01 to 2024-01-06; 0 could not be estimated. 0 drives"),
        (2, 1, "12 logs of 2 drives, 2024-01-01 to 2024-01-06; 0 could not be estimated. 1 drive "),
        (2, 2, "12 logs of 2 drives, 2024-01-01 to 2024-01-06; 0 could not be estimated. 2 drives"),
    ],
)
def test_the_headline(drives, marked, start):
    logs = [
        {"log": f"{d}{k}", "drive": str(d), "time": START + timedelta(days=k)}
        for d in range(drives)
        for k in range(6)
    ]
    items = [followed(str(d), remarks=("x",) if d < marked else ()) for d in range(drives)]
    text = headline(Fleet(Path(), rows(*logs)), items)
    assert text.startswith(start)
    assert text.endswith("with remarks.")
    untimed = rows(*logs).with_columns(time=pl.lit(None, pl.Datetime("us", "UTC")))
    assert f"of {drives} drive{'s' * (drives > 1)}; 0 could" in headline(
        Fleet(Path(), untimed), items
    )


def test_crossed_limits_come_first():
    items = [followed("a", remarks=("x", "y")), followed("", remarks=("z",), crossed=True)]
    assert remarks(items) == ["all logs: z.", "a: x.", "a: y."]


@pytest.mark.slow
def test_a_report_draws_forty_drives_those_with_remarks_first(tmp_path, monkeypatch):
    drawn = []

    def note_picture(items, drive):
        drawn.append(drive)
        return picture(items, drive) if len(drawn) == 1 else pictures[0]

    pictures = [picture([followed()], "a")]
    monkeypatch.setattr("fluxobs.fleets.report.picture", note_picture)
    for count in (DRAWN, DRAWN + 2):
        items = [followed(f"{k:02d}") for k in range(count)]
        items[-1] = replace(items[-1], remarks=("ages",))
        drawn.clear()
        write_html(Fleet(tmp_path, rows({"drive": "a"})), items, tmp_path / "x.html")
        page = (tmp_path / "x.html").read_text()
        assert len(drawn) == 40
        assert drawn[:2] == [f"{count - 1:02d}", "00"]
        assert ("2 more drives are only in the table" in page) == (count > 40)
        assert page.index("ages") > 0
        assert "Logs that failed" not in page


def test_a_picture_of_a_drive():
    steps = Course((Segment(0, 2, 3.0, 0.1), Segment(2, 4, 1.0, 0.1)), 0.0, 0.0, np.inf)
    axis, other = picture(
        [followed(course=steps, limits=(0.5, 3.5)), followed(name="psi_f")], "a"
    ).axes
    segments = [line for line in axis.lines if len(line.get_xdata()) == 2]
    assert [list(line.get_ydata()) for line in segments] == [
        [3.0, 3.0],
        [1.0, 1.0],
        [0.5, 0.5],
        [3.5, 3.5],
    ]
    days = [
        (line.get_xdata() - np.datetime64("2024-01-01")) / np.timedelta64(1, "D")
        for line in segments[:2]
    ]
    assert [list(day) for day in days] == [[0, 1], [2, 3]]
    assert axis.get_title() == "resistance [Ω]"
    assert other.get_title() == "magnet flux [Wb]"


def test_a_picture_shows_at_least_a_day():
    for hours, width in ((6, 1.0), (48, None)):
        item = replace(followed(), times=[START + timedelta(hours=hours * k / 3) for k in range(4)])
        (axis,) = picture([item], "a").axes
        lower, upper = axis.get_xlim()
        middle = np.datetime64("2024-01-01") + np.timedelta64(hours * 30, "m")
        days = (middle - np.datetime64("1970-01-01")) / np.timedelta64(1, "D")
        assert (lower + upper) / 2 == pytest.approx(days, abs=1e-6)
        if width is None:
            assert 2.0 <= upper - lower < 2.5
        else:
            assert upper - lower == pytest.approx(width)


@pytest.mark.parametrize("days", [1.0, 1.9, 2.1, 3.0, 3.9, 6.0, 33.0, 59.0, 400.0, 4000.0])
def test_axes_of_any_length_have_dates(days):
    item = replace(followed(), times=[START + timedelta(days=days * k / 3) for k in range(4)])
    (axis,) = picture([item], "a").axes
    assert 2 <= len(axis.get_xticks()) <= 6


@pytest.mark.parametrize(
    ("name", "time"),
    [
        ("2024-05-17", (2024, 5, 17)),
        ("2024_05_17 23.59", (2024, 5, 17, 23, 59)),
        ("2024.05.17-23h59m58", (2024, 5, 17, 23, 59, 58)),
        ("20240517T0000", (2024, 5, 17)),
        ("x20241231_2359", (2024, 12, 31, 23, 59)),
        ("2023-01-01/2024-10-09", (2024, 10, 9)),
        ("2024-13-01", None),
        ("2024-00-01", None),
        ("2024-01-32", None),
        ("2024-02-31", None),
        ("1999-01-01", None),
        ("120240517", None),
        ("202405171", None),
    ],
)
def test_a_date_in_a_name(name, time):
    expected = None if time is None else datetime(*time, tzinfo=UTC)
    assert Source("gone", name, "").time() == expected


@pytest.mark.parametrize(
    ("addresses", "folder"),
    [
        (["/a/b/c.csv"], "/a/b/"),
        (["/a/b/c.csv", "/a/b/d.csv"], "/a/b/"),
        (["/a/bb/c.csv", "/a/b/c.csv"], "/a/"),
        (["/a/b/c", "/a/b/c"], "/a/b/"),
        (["/a/b", "/a/b/c"], "/a/"),
        (["/a/b/c", "/d/e"], "/"),
        (["s3://x/a.csv", "s3://x/b.csv"], "s3://x/"),
    ],
)
def test_the_folder_that_logs_share(addresses, folder):
    assert shared(addresses) == folder


def test_a_drive_is_the_folder_or_what_a_pattern_finds(tmp_path):
    for name in ("a/1.csv", "b/c/2.csv", "3.csv"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x")
    assert [(log.name, log.drive) for log in sources([tmp_path])] == [
        ("3.csv", ""),
        ("a/1.csv", "a"),
        ("b/c/2.csv", "b/c"),
    ]
    assert [log.drive for log in sources([tmp_path], r"\d\.csv")] == ["3.csv", "1.csv", "2.csv"]
    assert [log.drive for log in sources([tmp_path], r"(\d)\.(csv)")] == ["3", "1", "2"]
    (log,) = sources([tmp_path / "b" / "c" / "2.csv"], root="/elsewhere/")
    assert log.name == f"{ELSEWHERE}{tmp_path.as_posix()[1:]}/b/c/2.csv"
    assert log.drive == "c"


@pytest.mark.parametrize(
    "name", ["A.CSV", "a.mf4", "a.csv.gz", "a.log", "readme2.txt", "Notes.md.txt"]
)
def test_files_that_are_logs(tmp_path, name):
    for path in (tmp_path / name, tmp_path / "Readme.TXT", tmp_path / "a.md", tmp_path / ".b.csv"):
        path.write_text("x")
    assert [log.name for log in sources([tmp_path])] == [name]


def test_only_urls_are_fetched():
    assert Source("s3://x/a.csv", "a.csv", "").remote
    assert not Source("/x/a.csv", "a.csv", "").remote


def test_a_stamp_is_size_and_time(tmp_path):
    log = tmp_path / "a.csv"
    log.write_text("four")
    assert Source(str(log), "a", "").stamp() == f"4 {log.stat().st_mtime_ns}"
    assert Source(str(tmp_path / "gone"), "a", "").stamp() == ""


def test_a_row_lists_the_mistakes_of_a_log():
    from fluxobs.fleets.log_task import summarise

    facts = {
        "rows": 200,
        "sample_time": 0.01,
        "lag": 1,
        "unknowns": ("drift", "resistance"),
        "valid_share": 0.5,
        "first_valid": 0.2,
        "warnings": [],
        "drift": (0.1, 0.2),
        "error": {"rms": 0.3, "most": 0.4},
    }
    for mistakes, text in (((), None), (("late", "swapped"), "late\nswapped")):
        checked = SimpleNamespace(mistakes=mistakes)
        row = summarise(SimpleNamespace(facts=facts, checked=checked, adaptive=None, learnt=None))
        assert row.get("mistakes") == text
        assert row["duration"] == 2.0
        assert row["warnings"] is None
        assert row["unknowns"] == "drift,resistance"
        assert (row["drift_alpha"], row["drift_beta"]) == (0.1, 0.2)
        assert (row["error_rms"], row["error_most"]) == (0.3, 0.4)
    plain = SimpleNamespace(
        facts=facts | {"drift": None, "error": None, "warnings": ["a", "b"]},
        checked=None,
        adaptive=None,
        learnt=None,
    )
    row = summarise(plain)
    assert "drift_alpha" not in row
    assert "error_rms" not in row
    assert row["warnings"] == "a\nb"
