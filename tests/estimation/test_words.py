"""Summary, warnings and choices of closed-form runs; limits are tested from both sides."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import fluxobs
from fluxobs.estimation import learning
from fluxobs.estimation.learning import (
    Parameter,
    doubtful,
    learning_segments,
    parameters,
)
from fluxobs.estimation.quality import Quality
from fluxobs.estimation.statistics import Statistics
from fluxobs.logs.for_machine import open_for
from fluxobs.logs.quality.marks import CLIPPED, MISSING, NO_CURRENT, OUTLIER
from fluxobs.logs.scales import Scales
from fluxobs.machines import example
from fluxobs.observers import AdaptiveObserver
from fluxobs.observers import for_log as prepare
from fluxobs.observers.adaptive import DC_LINK_SHARE
from fluxobs.observers.for_log import guess_psi_f, plain_observer, usual_speed
from fluxobs.page.columns import exact, flags, rounded
from fluxobs.presentation import report, warnings
from fluxobs.presentation.report import _channel_rows, _columns, _machine_in
from fluxobs.presentation.summary import _parameters, _score, lag_effect, si, summary_rows
from support.records import SERVO, log_columns, steady

H, ROWS = 1e-4, 3000
SAMPLES = steady(SERVO, H, 500.0, ROWS, 6j, 0.15 - 0.1j, -0.1 + 0.05j, 0.02)
SCALES = Scales(
    current=6.0, voltage=8.0, current_noise=0.02, voltage_noise=0.1, current_speed=500.0
)


@pytest.fixture(scope="module")
def run():
    return fluxobs.estimate(log_columns(SAMPLES), SERVO, unknowns="drift", causal=True)


@pytest.fixture(scope="module")
def log(run):
    return run.log


@pytest.mark.parametrize(
    ("value", "text"),
    [
        *(
            (1.0, "1 V"),
            (0.999, "999 mV"),
            (1e-3, "1 mV"),
            (9.99e-4, "999 µV"),
            (-2.5e-6, "-2.5 µV"),
        ),
        *((1e-9, "1 nV"), (9.94e-10, "9.9e-10 V"), (0.0, "0 V"), (1234.5, "1.23e+03 V")),
    ],
)
def test_numbers_with_prefixes(value, text):
    assert si(value, "V") == text


# ---- the summary ----------------------------------------------------------------------------


def changed(run, counts=None, **statistics):
    """Return the run with other counts and statistics."""
    counts = replace(run.counts, **(counts or {}))
    fields = {
        name: getattr(run, name)
        for name in ("log", "machine", "observer", "scales", "unknowns", "memory", "priors")
    }
    fields |= {"learnt": None, "automatic": False, "causal": False, "counts": counts}
    fields |= {"budget": run.budget, "lag": run.lag, "examined": None, "fractional_lag": None}
    return fluxobs.presentation.explanation.ExplainedRun(
        **fields, statistics=replace(run.statistics, **statistics)
    )


def test_numbers_of_a_summary(run):
    valid = 1500
    means = {"drift_alpha": 0.03, "drift_beta": -0.04, "psi_f": 0.0125}
    result = changed(
        run,
        rows=3000,
        valid=valid,
        start=1.0,
        first_valid=1.0125,
        sums={name: valid * value for name, value in means.items()},
        scored=1000,
        error=1000 * np.radians(0.5),
        error_squared=1000 * np.radians(2.0) ** 2,
        error_max=np.radians(7.25),
    )
    rows = dict(summary_rows(result, None, None))
    assert rows["log"] == "arrays: 3000 rows, 300 ms at 10000 Hz"
    assert rows["position"] == "valid on 50.0% of the rows, first after 12.5 ms"
    assert rows["  error"] == (
        "2.00° rms, 7.25° at most, mean 0.50°, on 1000 valid rows with a true value"
    )
    assert re.fullmatch(
        r"119\d to 12\d\d rpm on valid rows \(49\d to 5\d\d.\d rad/s electrical\)", rows["speed"]
    )
    assert rows["lag"] == "0, assumed: a voltage acts from its row on"
    assert rows["drift"] == (
        "+0.03, -0.04 V in αβ: as from a voltage offset of 50 mV, or a current offset of 139 mA"
    )
    assert rows["magnet flux"] == "12.5 mWb"
    never = dict(summary_rows(changed(run, first_valid=None), None, None))
    assert never["position"] == "never valid"


@pytest.mark.parametrize(
    ("lag", "effect"),
    [
        (0.0, "a voltage acts from its row on"),
        (1.0, "a voltage acts 1 sample earlier than its row"),
        (-1.0, "a voltage acts 1 sample later than its row"),
        (-2.5, "a voltage acts 2.5 samples later than its row"),
    ],
)
def test_the_effect_of_a_lag(lag, effect):
    assert lag_effect(lag) == effect


def test_a_score_against_a_truth_with_wrong_turns_is_left_out(run):
    result = changed(run, scored=10, error=0.0, error_squared=0.0, error_max=0.0)
    assert _score(result, None)
    assert not _score(result, SimpleNamespace(wrong_turns=True, told=False))
    assert not _score(changed(run, scored=0), None)


# ---- warnings -------------------------------------------------------------------------------


def test_bad_rows_are_counted(run):
    quality = Quality()
    marks = np.zeros(8, int)
    marks[[1, 3, 4]], marks[6], marks[7] = MISSING, OUTLIER, NO_CURRENT
    quality.add(0.1 * np.arange(8), marks)
    counts = {"outside": 2, "restarts": 4}
    (message,) = warnings._samples(changed(run, counts, quality=quality))
    assert message == (
        "Bad rows: 3 missing (0.1 s, 0.3 to 0.4 s), 1 outlier (0.6 s), 2 with a current outside "
        "the machine's flux map (not valid); observer restarts: 4."
    )
    assert warnings._samples(changed(run, {"restarts": 4}, quality=Quality())) == []


def test_a_mark_that_crosses_two_batches_is_one_stretch():
    quality = Quality()
    quality.add(np.array([0.0, 1.0]), np.array([0, CLIPPED]))
    quality.add(np.array([2.0, 3.0]), np.array([CLIPPED, 0]))
    entry = quality.marked["clipped"]
    assert (entry.rows, entry.count, entry.stretches) == (2, 1, [(1.0, 2.0)])


def run_at(run, speed):
    """Return a run whose estimated speed is constant."""
    columns = {"speed_e": np.full(10, speed), "valid": np.ones(10)}
    thin = SimpleNamespace(columns=lambda: columns)
    return SimpleNamespace(
        log=run.log,
        scales=SCALES,
        statistics=SimpleNamespace(thin=thin, quality=Quality()),
        machine=run.machine,
    )


@pytest.mark.parametrize(("period", "warned"), [(8.05, False), (7.95, True)])
@pytest.mark.parametrize("direction", [1, -1])
def test_eight_samples_per_period(run, period, warned, direction):
    messages = warnings._rate(run_at(run, direction * 2 * np.pi / (period * H)))
    assert bool(messages) == warned
    if warned:
        assert "Only 7.9 samples per electrical period at 7903 rad/s: at least 8 are" in messages[0]
        assert "a sample rate of 10063 Hz or more" in messages[0]


def test_without_a_position_the_speed_of_the_current_counts(run):
    result = run_at(run, 1e6)
    result.statistics.thin.columns = lambda: {"speed_e": np.ones(3), "valid": np.zeros(3)}
    assert warnings._rate(result) == []
    result.scales = replace(SCALES, current_speed=2e4)
    assert "at 2e+04 rad/s" in warnings._rate(result)[0]
    result.scales = replace(SCALES, current_speed=0.0)
    assert warnings._rate(result) == []


@pytest.mark.parametrize(("valid", "warned"), [(1500, False), (1499, True)])
def test_half_of_the_rows_must_be_valid(run, valid, warned):
    assert bool(warnings._validity(changed(run, rows=3000, valid=valid))) == warned


@pytest.mark.parametrize(("drops", "standing"), [(1.99, True), (2.01, False)])
def test_a_voltage_of_two_resistive_drops_means_standstill(run, drops, standing):
    result = changed(run, rows=3000, valid=300)
    scales = replace(SCALES, voltage=drops * SERVO.R_s * SCALES.current)
    (message,) = warnings._validity(replace(result, scales=scales))
    assert message.startswith("The position is valid on only 10.0% of the rows: ")
    assert ("standstill" in message) == standing
    assert ("check R_s" in message) != standing


@pytest.mark.parametrize(("missing", "blamed"), [(1000, True), (999, False)])
def test_rows_without_a_current_explain_invalid_rows(run, missing, blamed):
    result = changed(run, {"bad_currents": missing}, rows=3000, valid=1000)
    (message,) = warnings._validity(result)
    assert message.startswith("The position is valid on only 33.3% of the rows")
    assert (f"{missing} rows have no current" in message) == blamed


@pytest.mark.parametrize(("scored", "warned"), [(990, False), (989, True)])
def test_a_truth_with_values_on_few_rows(run, scored, warned, monkeypatch):
    monkeypatch.setattr(warnings, "is_position", lambda *_: True)
    messages = warnings._truth(changed(run, valid=1000, scored=scored))
    expected = f"The true angle is known on only {scored} of 1000 valid rows."
    assert messages == ([expected] if warned else [])


@pytest.mark.parametrize(("memories", "short"), [(3.01, False), (2.99, True)])
def test_a_log_must_last_three_memories(run, memories, short):
    rows = round(memories * run.observer.memory / H)
    messages = warnings.warnings(changed(run, rows=rows), None)
    assert (
        any("too short to settle: at least 3 memories" in message for message in messages) == short
    )


def residual_of(run, share):
    """Return a run whose residual is this share of the flux squared."""
    flux = 0.0125
    rms = share * flux**2 / run.plain.constraint_noise
    changes = {"valid": 100, "sums": {"psi_f": 100 * flux}, "settled": 50}
    return changed(run, **changes, innovation=50 * rms**2)


@pytest.mark.parametrize(("share", "warned"), [(0.0099, False), (0.0101, True)])
def test_a_residual_of_one_percent(run, share, warned):
    result = replace(residual_of(run, share), scales=replace(SCALES, current_noise=0.0))
    messages = warnings._residual(result, run.plain, None)
    assert bool(messages) == warned
    if warned:
        assert "larger than noise explains: 1.0% of the flux squared" in messages[0]
    assert not warnings._residual(changed(run, valid=0), run.plain, None)


@pytest.mark.parametrize(("times", "doubted"), [(2.99, False), (3.01, True)])
def test_a_residual_of_three_times_the_noise(times, doubted):
    """The noise of each component is the current's noise times 2 x inductance x flux."""
    flux, noise = 0.0125, 0.5
    share = SERVO.constraint_noise(flux, noise) / flux**2
    assert share > 0.01
    scales = replace(SCALES, current_noise=noise)
    assert doubtful(times * share, SERVO, flux, scales) == doubted
    assert doubtful(np.nan, SERVO, flux, scales)


# ---- identifiability -------------------------------------------------------------------------


def test_half_of_the_prior_is_identifiable():
    parameter = Parameter("resistance", "Ω", 1.0, prior=0.2, value=1.1, std=0.1)
    assert parameter.told
    assert not replace(parameter, std=0.101).told


class LongLog:
    """The attributes of a log that the choice of segments uses."""

    def __init__(self, rows, random_access=True):
        self.first, self.last = 7, 7 + rows
        self.table = SimpleNamespace(random_access=random_access)

    def __len__(self):
        return self.last - self.first


def test_segments_of_a_long_log():
    most = learning.SEGMENTS * learning.SEGMENT_ROWS
    assert learning_segments(LongLog(most)) == [(7, 7 + most)]
    assert learning_segments(LongLog(99_000_000, False)) == [(7, 99_000_007)]
    segments = np.array(learning_segments(LongLog(learning.SEGMENT_ROWS + 22_000_000)))
    np.testing.assert_array_equal(segments[:, 0], 7 + 2_000_000 * np.arange(12))
    np.testing.assert_array_equal(segments[:, 1] - segments[:, 0], learning.SEGMENT_ROWS)
    assert len(learning_segments(LongLog(12_000_001))) == 12


ADAPTIVE = AdaptiveObserver.for_machine(
    SERVO, sample_time=H, unknowns=("drift", "resistance", "inverter")
)


def learnt(resistance=(0.0, 0.01), inverter=(0.0, 0.01)):
    """Return learnt values from pairs (error in standard deviations, share of the prior)."""
    r_std = resistance[1] * ADAPTIVE.resistance_std
    v_std = inverter[1] * ADAPTIVE.inverter_std
    return SimpleNamespace(
        psi_f=SERVO.psi_f,
        psi_f_std=1e-9,
        resistance=ADAPTIVE.resistance + resistance[0] * r_std,
        resistance_std=r_std,
        inverter_voltage=ADAPTIVE.inverter_voltage + inverter[0] * v_std,
        inverter_std=v_std,
    )


@pytest.mark.parametrize(("std", "listed"), [(0.0, False), (1e-3, True), (0.02, True)])
def test_an_inductance_is_listed_if_it_was_learnt(std, listed):
    """An inductance assumed to be exact has no standard deviation."""
    run = fluxobs.estimate(
        fluxobs.demo_log(), "servo-400w", unknowns="drift,resistance", causal=True
    )
    learnt = replace(run.learnt, inductance_error=(0.05, 0.0), inductance_std=(std, 0.0))
    rows = dict(_parameters(replace(run, learnt=learnt)))  # 600 µH, 5 % more is learnt
    assert ("L_s" in rows) == listed
    if listed:
        assert rows["L_s"].startswith(f"630.00 ± {600 * std:.2f}" if std < 0.01 else "630 ± 12")
        assert rows["L_s"].endswith("µH (file 600 µH)")


def test_only_unknown_parameters_are_listed():
    listed = parameters(ADAPTIVE, learnt())
    assert [(parameter.name, parameter.unit) for parameter in listed] == [
        *(("magnet flux", "Wb"), ("resistance", "Ω"), ("inverter", "V"))
    ]
    assert listed[1].assumed == SERVO.R_s
    fixed = replace(ADAPTIVE, inverter_std=0.0)
    assert [parameter.name for parameter in parameters(fixed, learnt())] == [
        "magnet flux",
        "resistance",
    ]


# ---- settings -------------------------------------------------------------------------------


def test_settings_derived_from_a_log(log):
    observer = plain_observer(log, SERVO, SCALES, 0.0123)
    assert observer.memory == 0.0123
    assert observer.current_noise == 0.02
    assert observer.drift_prior >= 0.01 * SCALES.voltage
    large = plain_observer(log, SERVO, replace(SCALES, voltage=123.456), 0.0123)
    assert large.drift_prior == 1.23
    noiseless = plain_observer(log, SERVO, replace(SCALES, current_noise=1e-9), 0.0123)
    assert noiseless.current_noise == pytest.approx(1e-4 * SERVO.rated_current)
    unrated = SERVO.with_values(rated_current=None)
    noiseless = plain_observer(log, unrated, replace(SCALES, current_noise=1e-9), 0.0123)
    assert noiseless.current_noise == pytest.approx(1e-4 * SCALES.current)
    rounded_noise = plain_observer(log, SERVO, replace(SCALES, current_noise=0.0234567), 0.0123)
    assert rounded_noise.current_noise == 0.0235


def test_the_default_memory_is_at_least_ten_samples(log):
    slow = replace(log, clock=replace(log.clock, sample_time=5e-3))
    assert plain_observer(slow, SERVO, SCALES, None).memory >= 10 * 5e-3
    usual = plain_observer(log, SERVO, SCALES, None).memory
    assert usual == float(f"{SERVO.memory_for(H, 500.0):.3g}")


@pytest.mark.parametrize(("rows", "fits"), [(10, True), (9.99, False)])
def test_a_given_memory_must_have_ten_samples(log, rows, fits):
    if fits:
        assert prepare._check_memory(log, SERVO, rows * H) == rows * H
    else:
        with pytest.raises(
            fluxobs.FluxobsError, match=r"too short: give at least ten samples, 0.001 s"
        ):
            prepare._check_memory(log, SERVO, rows * H)


def test_a_log_too_slow_for_the_usual_memory(log):
    assert prepare._check_memory(log, SERVO, None) == SERVO.memory
    slow = replace(log, clock=replace(log.clock, sample_time=SERVO.memory / 9.99))
    with pytest.raises(fluxobs.RecordError, match="is too slow for a memory of"):
        prepare._check_memory(slow, SERVO, None)


def test_the_usual_speed():
    """The usual speed is the speed of the currents, limited to voltage over flux."""
    base = SERVO.flux_base(SCALES.current)
    assert usual_speed(SERVO, SCALES, None) == 500.0
    slow = replace(SCALES, voltage=100 * base)
    assert usual_speed(SERVO, slow, None) == pytest.approx(100.0)
    unknown = SERVO.with_values(psi_f=None)
    assert usual_speed(unknown, replace(SCALES, voltage=0.01), None) == 500.0


@pytest.mark.parametrize("psi_f", [0.004, 0.0125, 0.12])
def test_a_magnet_is_guessed_from_the_log(psi_f):
    machine = SERVO.with_values(psi_f=psi_f)
    samples = steady(machine, H, 500.0, 3000, 6j, noise=0.02)
    log = fluxobs.read_log(log_columns(samples))
    unknown = machine.with_values(psi_f=None)
    assert guess_psi_f(log, unknown, SCALES, None) == pytest.approx(psi_f, rel=0.02)


@pytest.mark.parametrize(
    ("name", "largest"),
    [("inverter", 8.0), ("psi_f", 0.0125), ("resistance", 10 * 0.36)],
)
def test_priors_too_large_for_standard_deviations(log, name, largest):
    unknowns = ("drift", "resistance", "inverter")
    prepare.prepare(log, SERVO, unknowns, None, {name: 0.99 * largest}, SCALES)
    with pytest.raises(fluxobs.FluxobsError, match=f"prior {name}=.*, {largest:.3g}: give"):
        prepare.prepare(log, SERVO, unknowns, None, {name: 1.01 * largest}, SCALES)


def test_the_observer_of_a_levitation():
    """Sizes in the observer follow from sizes of the machine and the log."""
    machine = example("maglev-knospe")
    rows = 400
    wave = np.stack([1 + 0.1 * np.sin(0.1 * np.arange(rows)), np.ones(rows)], axis=1)
    log = open_for((wave, wave), machine, sample_time=1e-4)
    scales = replace(SCALES, current=2.0, voltage=5.0, current_noise=0.0)
    rated = machine.rated_current or 2.0
    for unknowns in (("drift",), ("drift", "current-bias")):
        run = prepare.prepare(log, machine, unknowns, None, {}, scales)
        assert run.batch == 2000
        observer = run.observer
        assert observer.current_noise == pytest.approx(1e-4 * rated)
        np.testing.assert_allclose(observer.current_bias_prior, 0.02 * rated)
        drift = 0.01 * 5.0 * np.abs(machine.B).max()
        if "current-bias" in unknowns:
            drift = max(drift, 0.02 * rated * np.abs(machine.R).max())
        np.testing.assert_allclose(observer.drift_prior, drift)
        np.testing.assert_allclose(observer.flux_base, machine.flux_base(rated))


# ---- statistics and reports -----------------------------------------------------------------


@pytest.mark.parametrize("size", [640, 10_000])
@pytest.mark.parametrize("first", [100, 1500, 5000, 8999])
def test_rows_for_a_picture(size, first):
    """Keep every second of 9000 rows, and all rows 1000 before to 2000 after validity begins."""
    statistics = Statistics(9000)
    t = np.arange(9000.0)
    for begin in range(0, 9000, size):
        times = t[begin : begin + size]
        statistics.add(
            SimpleNamespace(
                columns={"t": times}, valid=times >= first, error=None, innovation=None, more={}
            )
        )
    np.testing.assert_array_equal(statistics.thin.columns()["t"], t[::2])
    window = statistics.detail.columns()["t"]
    assert window[-1] == min(first + 1999, 8999)
    start = max(0, first - 1000)
    assert window[0] == (start if size == 10_000 else max(start, first // size * size))
    np.testing.assert_array_equal(np.diff(window), 1)


def test_the_machine_of_a_command():
    assert _machine_in("fluxobs estimate log --machine 'my motor.toml' --lag -1") == "my motor.toml"
    assert _machine_in("fluxobs estimate log") == "MACHINE"
    assert _machine_in(None) == "MACHINE"


def test_channels_and_their_conversions():
    conversions = {"i_a": (1e-3, 0.0), "i_b": (1e-3, -0.5), "u_a": (1.0, 2.0)}
    log = SimpleNamespace(
        names={"i_a": "Ia", "i_b": "Ib", "u_a": "Ua", "u_b": "Ub"},
        conversions=conversions,
        true=SimpleNamespace(channel="hall", columns=("x", "y")),
    )
    assert _channel_rows(log) == [
        ["i_a", "Ia", "× 0.001"],
        ["i_b", "Ib", "× 0.001 + -0.5"],
        ["u_a", "Ua", "+ 2"],
        ["u_b", "Ub", "as it is"],
        ["hall", "x y", "true, for the score"],
    ]


@pytest.mark.parametrize("rated", [3.0, 12.0, 30.0])
def test_without_a_rated_current_the_current_of_the_log_counts(log, rated):
    """A given rated current is used for every log."""
    unknowns = ("drift", "resistance", "inverter")
    observers = [
        prepare.prepare(log, machine, unknowns, 0.02, {}, replace(SCALES, current=current)).observer
        for machine, current in (
            (SERVO.with_values(rated_current=None), rated),
            (SERVO.with_values(rated_current=rated), 6.0),
            (SERVO.with_values(rated_current=rated), 7.0),
        )
    ]
    assert observers[0].inverter_std == observers[1].inverter_std == observers[2].inverter_std
    assert observers[0].inverter_current == observers[1].inverter_current
    assert observers[1].inverter_current == observers[2].inverter_current
    usual = prepare.prepare(log, SERVO, unknowns, 0.02, {}, SCALES).observer.inverter_current
    assert observers[1].inverter_current == pytest.approx(usual * rated / SERVO.rated_current)


def test_the_dc_link_of_a_log_is_at_least_the_line_voltage(log):
    """If the drop at rated current is small, the inverter's prior is a share of the DC link."""
    unknowns = ("drift", "inverter")
    stds = [
        prepare.prepare(
            log, SERVO.with_values(R_s=1e-3), unknowns, 0.02, {}, replace(SCALES, voltage=voltage)
        ).observer.inverter_std
        for voltage in (100.0, 200.0)
    ]
    assert stds[1] == pytest.approx(2 * stds[0], rel=0.01)
    assert stds[0] == pytest.approx(DC_LINK_SHARE * 100 * np.sqrt(3), rel=0.005)


def test_the_columns_of_a_report(run):
    """A report has packed flags, exact times, and only columns that a picture shows."""
    columns = _columns(run)
    drawn = {"i_d", "i_q", "u_d", "u_q"}
    assert set(columns) == (set(run.estimates.columns) - set(report.NOT_SHOWN)) | drawn
    assert columns["valid"] == flags(run["valid"])
    assert columns["t"] == exact(run["t"])
    assert columns["theta_e_std"] == rounded(run["theta_e_std"])


@pytest.mark.parametrize(("limit", "included"), [(ROWS, True), (ROWS - 1, False)])
def test_a_report_leaves_out_a_large_record(run, monkeypatch, limit, included):
    monkeypatch.setattr(report, "MAX_RECORD_ROWS", limit)
    record = report._record(run)
    assert (record is not None) == included
    if record is not None:
        assert record["start"] == run["t"][0]
        assert record["t"] is None
        assert set(record["columns"]) == {"u_alpha", "u_beta", "i_alpha", "i_beta"}
        assert record["columns"]["i_alpha"] == exact(SAMPLES.current[:, 0])
        size = sum(len(column["data"]) for column in record["columns"].values())
        monkeypatch.setattr(report, "MAX_RECORD_SIZE", size)
        assert report._record(run) is not None
        monkeypatch.setattr(report, "MAX_RECORD_SIZE", size - 1)
        assert report._record(run) is None
