"""Guesses from values, units and names of columns, tested at the limits of each guess."""

import math

import numpy as np
import pytest

from fluxobs import RecordError, read_log
from fluxobs.logs.formats.arrays import ArrayTable
from fluxobs.logs.formats.table import Said
from fluxobs.logs.log import Truth
from fluxobs.logs.meaning import units
from fluxobs.logs.meaning.guess import NamedTable, _is_index, electrical_or_mechanical, turn_of
from fluxobs.logs.meaning.names import is_setpoint, leaf, read_name, unit_in

K = np.arange(400)
Z = np.exp(0.1j * K)
TURN = np.exp(-2j * np.pi / 3 * np.arange(3))
T = {"t": 1e-3 * K}
AXES = {"u_alpha": 10 * Z.real, "u_beta": 10 * Z.imag, "i_alpha": Z.real, "i_beta": Z.imag}


def phases(z):
    return (z[:, None] * TURN).real.T


CURRENTS = dict(zip(("i_a", "i_b", "i_c"), phases(Z), strict=True))


# ---- values ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "unit"),
    [
        *((2e-5, "s"), (0.0199, "s"), (0.0201, "ms"), (19.9, "ms"), (20.1, "us")),
        *((1.99e-5, None), (1.99e4, "us"), (2.01e4, "ns"), (1.99e7, "ns"), (2.01e7, None)),
    ],
)
def test_a_time_step_lies_between_20_us_and_20_ms(step, unit):
    log = read_log(AXES | {"t": step * K})
    assert log.layout.unit.get("t", "s") == (unit or "s")
    assert any("t has no unit" in note for note in log.notes) == (unit in ("ms", "us", "ns"))


@pytest.mark.parametrize(
    ("low", "high", "unit"),
    [
        *((-0.019, 1.0, None), (-0.021, 1.0, "-1..1"), (-1.5, 1.5, "-1..1"), (0.0, 1.49, None)),
        *((0.0, 1.51, "%"), (0.0, 100.0, "%"), (-1.51, 1.5, "%"), (0.0, 100.1, None)),
    ],
)
def test_the_unit_of_a_duty(low, high, unit):
    wave = (phases(Z) - phases(Z).min()) / np.ptp(phases(Z))
    duties = dict(zip(("d_a", "d_b", "d_c"), low + (high - low) * wave, strict=True))
    log = read_log(T | duties | CURRENTS, udc=50.0)
    assert log.layout.unit.get("d_a") == unit


@pytest.mark.parametrize(
    ("size", "unit"), [(0.91, "deg"), (0.89, None), (1.09, "deg"), (1.3, None)]
)
def test_a_wrap_may_miss_a_turn_by_a_tenth(size, unit):
    """This limit applies to an angle that turns slowly."""
    assert turn_of(np.mod(K * 3.0, 360.0 * size)) == unit


def test_a_wrap_may_miss_a_turn_by_three_steps():
    """This limit applies to an angle that turns quickly, here by 70° in a sample."""
    assert turn_of(np.array([0.0, 70.0, 140.0, 210.0, 280.0, 350.0, 60.0])) == "deg"
    assert turn_of(np.array([350.0, 70.0])) is None


@pytest.mark.parametrize("pairs", [1.0, 1.45, 1.55, 4.0])
@pytest.mark.parametrize("direction", [1, -1])
def test_an_angle_is_mechanical_if_the_current_turns_faster(pairs, direction):
    """The current must be 1.5 times as fast; direction and missing values have no effect."""
    angle = np.mod(direction * 0.1 * K / pairs, 2 * np.pi)
    angle[5] = np.nan
    channel = electrical_or_mechanical(angle, Z)
    assert channel == ("theta_mech" if pairs > 1.5 else "theta_e")


def test_an_angle_that_says_nothing_is_electrical():
    assert electrical_or_mechanical(np.zeros(400), Z) == "theta_e"
    few = np.where(K < 9, 0.02 * K, np.nan)
    assert electrical_or_mechanical(few, Z) == "theta_e"
    few[9] = 0.18
    assert electrical_or_mechanical(few, Z) == "theta_mech"


@pytest.mark.parametrize(
    ("values", "time"),
    [
        (2 * K, True),
        (K + 1, False),  # numbers of rows
        (np.array([1.0, 1.19, 0.81])[K % 3].cumsum(), True),
        (np.array([1.0, 1.21, 0.79])[K % 3].cumsum(), False),
        (np.where(K == 200, -1.0, 1.1).cumsum(), False),
        (2 * K[:11], False),
    ],
)
def test_a_column_without_a_name_is_time_if_it_rises_evenly(values, time):
    """Such a column must have at least ten steps."""
    table = {"": values.astype(float)} | {n: v[: len(values)] for n, v in AXES.items()}
    if len(values) < 20:
        with pytest.raises(RecordError, match="rows of data are too few"):
            read_log(table, unit={"t": "ms"})
    elif time:
        assert read_log(table, unit={"t": "ms"}).names["t"] == ""
    else:
        with pytest.raises(RecordError, match="no sample time"):
            read_log(table, unit={"t": "ms"})


@pytest.mark.parametrize(
    ("apart", "frame"), [(0.0, "abc"), (0.1, "abc"), (0.28, None), (-0.1, "abc"), (-0.3, None)]
)
def test_columns_with_units_alone_are_phases_by_their_angles(apart, frame):
    """Cosines may differ from -1/2 by 0.2, so angles are between 107.5° and 134.4°."""
    turn = TURN * np.exp(1j * np.array([0, 0, apart]))
    wave = {f"Ch{n} [V]": 10 * (Z * turn[n]).real for n in range(3)}
    wave |= {f"Ch{n + 3} [A]": (Z * TURN[n]).real for n in range(3)}
    if frame is None:
        with pytest.raises(RecordError, match="are not found among its columns"):
            read_log(T | wave)
    else:
        log = read_log(T | wave)
        assert (log.frame, log.names["u_b"], log.names["i_c"]) == (frame, "Ch1 [V]", "Ch5 [A]")


@pytest.mark.parametrize(
    ("count", "frame"), [((3, 3), "abc"), ((2, 3), "line"), ((2, 2), "line"), ((3, 2), "abc")]
)
def test_two_phase_voltages_are_line_to_line(count, frame):
    wave = {f"Ch{n} [V]": 10 * (Z * TURN[n]).real for n in range(count[0])}
    wave |= {f"Ch{n + 3} [A]": (Z * TURN[n]).real for n in range(count[1])}
    assert read_log(T | wave).frame == frame


def test_axes_are_at_a_right_angle():
    wave = {"p [V]": Z.real, "q [V]": Z.imag, "r [A]": Z.real, "s [A]": Z.imag}
    log = read_log(T | wave)
    assert (log.frame, log.names["u_beta"], log.names["i_alpha"]) == ("alphabeta", "q [V]", "r [A]")


@pytest.mark.parametrize(("mean", "taken"), [(1.3, True), (1.5, False)])
def test_a_column_swings_by_more_than_half_its_mean(mean, taken):
    """A sine of amplitude 1 has a standard deviation of 0.707, so the limit is a mean of 1.41."""
    wave = {"p [V]": Z.real + mean, "q [V]": Z.imag, "r [A]": Z.real, "s [A]": Z.imag}
    if taken:
        assert read_log(T | wave).frame == "alphabeta"
    else:
        with pytest.raises(RecordError, match="are not found"):
            read_log(T | wave)


# ---- units ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("channel", "spellings", "factor"),
    [
        ("t", "s sec second sek S", 1.0),
        ("t", "ms msec milliseconds Milliseconds", 1e-3),
        ("t", "us µs μs usec microsecond", 1e-6),
        ("t", "ns nsec", 1e-9),
        ("t", "min", 60.0),
        ("i_a", "A a amp Amps [A] ampere", 1.0),
        ("i_b", "mA ma", 1e-3),
        ("i_alpha", "uA µA", 1e-6),
        ("i_q", "kA", 1e3),
        ("u_a", "V volts (V)", 1.0),
        ("udc", "mV mv", 1e-3),
        ("u_ab", "kV", 1e3),
        ("u_c", "uV", 1e-6),
        ("d_a", "% percent", 0.01),
        ("d_b", "-1..1", 0.5),
        ("d_c", "1 pu p.u. -", 1.0),
        ("theta_e", "rad radians RAD", 1.0),
        ("theta_e", "mrad", 1e-3),
        ("theta_mech", "deg ° degrees Degree", math.pi / 180),
        ("theta_mech", "rev turns Revolution", 2 * math.pi),
        ("speed_mech", "rad/s rads rad/sec", 1.0),
        ("speed_mech", "rpm RPM 1/min min^-1 r/min min⁻¹ min-1", 2 * math.pi / 60),
        ("speed_e", "Hz hz 1/s rps turns/s", 2 * math.pi),
        ("speed_e", "deg/s °/s", math.pi / 180),
        ("speed_mech", "krpm", 1e3 * 2 * math.pi / 60),
        ("position", "m", 1.0),
        ("position", "cm", 1e-2),
        ("position", "mm", 1e-3),
        ("position", "um µm", 1e-6),
        ("i_a", "q0", 1.0),
        ("i_a", "q8 Q8", 1 / 256),
        ("u_a", "Q15", 2.0**-15),
        ("t", "ticks:170e6", 1 / 170e6),
        ("theta_e", "counts:4096", 2 * math.pi / 4096),
        ("d_a", "counts:1000", 1e-3),
    ],
)
def test_units(channel, spellings, factor):
    for spelling in spellings.split():
        assert units.factor(channel, spelling) == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize(
    ("channel", "unit", "message"),
    [
        ("i_a", "mV", "that is a unit of voltage, not of current"),
        ("t", "mm", "that is a unit of length, not of time"),
        ("i_a", "Aa", "unknown unit"),
        ("hall", "V", "the channel hall has no unit"),
        ("t", "ticks:0", "'0' is not a positive number"),
        ("t", "ticks:-5", "'-5' is not a positive number"),
        ("t", "ticks:inf", "'inf' is not a positive number"),
        ("t", "ticks:x", "'x' is not a positive number"),
        ("t", "counts:100", "ticks:HZ is for t"),
        ("i_a", "counts:100", r"give adc={'i_a': 'BITS,RANGE,ZERO'}"),
        ("theta_e", "ticks:100", "counts:FULL_SCALE is for angles"),
    ],
)
def test_units_that_do_not_fit(channel, unit, message):
    with pytest.raises(RecordError, match=message):
        units.factor(channel, unit)


def test_converters():
    assert units.adc("i_a", "12,100") == pytest.approx((100 / 4096, -50.0))
    assert units.adc("i_a", "12, 100, 2000") == pytest.approx((100 / 4096, -100 * 2000 / 4096))
    assert units.adc("u_a", "1,-2,0") == pytest.approx((-1.0, 0.0))
    assert units.adc("u_a", "32,1,0")[0] == pytest.approx(2.0**-32)


@pytest.mark.parametrize(
    "given", ["12", "12,0", "0,1", "33,1", "12.5,1", "1,2,3,4", "a,1", "inf,1"]
)
def test_malformed_converters(given):
    with pytest.raises(RecordError, match="expected BITS,RANGE or BITS,RANGE,ZERO"):
        units.adc("i_a", given)


@pytest.mark.parametrize(("unit", "kinds"), [("1", set()), ("-", set()), ("", set()), ("x", set())])
def test_texts_without_a_quantity(unit, kinds):
    assert units.known(unit) == kinds


def test_the_quantities_of_a_unit():
    assert units.known("m") == {"length"}
    assert units.known("[mA]") == {"current"}
    assert units.known("1/s") == {"speed"}


# ---- names ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("column", "channel", "unit"),
    [
        ("Ia [mA]", "i_a", "mA"),
        ("U [V]", "u_a", "V"),
        ("W [V]", "u_c", "V"),
        ("A [A]", "i_a", "A"),
        ("Encoder elec [deg]", "theta_e", "deg"),
        ("Encoder mech [deg]", "theta_mech", "deg"),
        ("Ia (mA) filt", "i_a", "mA"),
        ("Phase current / A", None, "A"),
        ("I_b, A", "i_b", "A"),
        ("time in ms", "t", "ms"),
        ("in s", None, "s"),
        ("CH1V", None, "V"),
        ("u_a_V", "u_a", "V"),
        ("theta_deg", "theta", "deg"),
        ("time-ms", "t", "ms"),
        ("drive.foc.i_q", "i_q", None),
        ("voltages/a", "u_a", None),
        ("drive/i_a/value", "i_a", None),
        ("drive/i_a/Out1", "i_a", None),
        ("iα", "i_alpha", None),
        ("speed rpm", "speed_mech", "rpm"),
        ("erpm", "speed_e", None),
        ("Uvw", "u_bc", None),
        ("L1L2", None, None),
        ("UL1L2", "u_ab", None),
        ("i_t", "i_c", None),
        ("VBUS", "udc", None),
        ("temperature", None, None),
    ],
)
def test_channel_and_unit_of_a_name(column, channel, unit):
    assert read_name(column) == (channel, unit)


@pytest.mark.parametrize(
    ("column", "setpoint"),
    [
        ("i_a_ref", True),
        ("Iq* [A]", False),
        ("iq_soll", True),
        ("iq_cmd [mA]", True),
        ("i_a", False),
    ],
)
def test_setpoints(column, setpoint):
    assert is_setpoint(column) == setpoint


@pytest.mark.parametrize(
    ("values", "sample_time", "counts"),
    [
        ([4.0, 5.0], 1e-4, True),
        ([4.0, 5.0, 6.0], 1e-4, True),
        ([4.0, 5.0, 6.0], None, False),  # if the file has no sample time, the column may be t
        ([4.0], 1e-4, False),
        ([], 1e-4, False),
        ([4.0, 5.0, 7.0], 1e-4, False),
        ([5.0, 4.0], 1e-4, False),
        ([4.0, 4.0], 1e-4, False),
    ],
)
def test_a_column_that_counts_rows(values, sample_time, counts):
    table = ArrayTable({"n": values})
    table.said = Said(sample_time=sample_time)
    assert _is_index(NamedTable(table, {"n": "n"}), "n") == counts


def test_parts_of_names():
    assert leaf("a/b/value") == "b"
    assert leaf("value") == "value"
    assert leaf("out/in") == "out"
    assert unit_in("i/A") == ("i", "A")
    assert unit_in("group/sub/i [A]") == ("i", "A")
    assert unit_in("i_a") is None


@pytest.mark.parametrize("given", [None, "abc", "alphabeta"])
def test_currents_in_a_frame_of_their_own(given):
    """The frame is the given frame, or the frame whose columns exist."""
    voltages = {"u_alpha": 10 * Z.real, "u_beta": 10 * Z.imag}
    currents = {"i_a": CURRENTS["i_a"], "i_b": CURRENTS["i_b"]}
    if given == "alphabeta":
        with pytest.raises(RecordError, match="no column 'i_alpha'"):
            read_log(T | voltages | currents, currents=given)
    else:
        log = read_log(T | voltages | currents, currents=given)
        assert (log.frame, log.current_frame) == ("alphabeta", "abc")
        (rows,) = log.aligned()
        np.testing.assert_allclose(rows.current, np.stack([Z.real, Z.imag], 1), atol=1e-12)


# ---- true angles of several columns ---------------------------------------------------------


def test_sine_and_cosine_are_centred_and_scaled():
    columns = {"s": 100 + 20 * np.sin(0.1 * K), "c": -50 + 30 * np.cos(0.1 * K)}
    true = read_log(T | AXES | columns, truth={"sincos": "s, c"}).true
    assert (true.channel, true.columns, true.guessed) == ("theta_mech", ("s", "c"), False)
    np.testing.assert_allclose(true.centre, [100, -50], atol=0.1)
    np.testing.assert_allclose(true.size, [20, 30], atol=0.1)
    values = [columns["s"], columns["c"]]
    np.testing.assert_allclose(np.unwrap(true.of(values)), 0.1 * K, atol=0.01)


def test_three_hall_sensors_are_levels_one_column_is_their_code():
    states = {f"h{k}": 5.0 * (np.cos(0.1 * K - 2 * np.pi / 3 * k) > 0) for k in range(3)}
    true = read_log(T | AXES | states, truth={"hall": "h0,h1,h2"}).true
    assert (true.channel, true.columns) == ("hall", ("h0", "h1", "h2"))
    np.testing.assert_allclose(true.centre, 2.5)
    np.testing.assert_allclose(true.size, 2.5)
    code = {"code": 1 + K % 6.0}
    true = read_log(T | AXES | code, truth={"hall": "code"}).true
    assert (true.channel, true.columns) == ("hall", ("code",))
    np.testing.assert_array_equal(true.centre, 0.0)


@pytest.mark.parametrize(
    ("truth", "message"),
    [
        ({"sincos": "s"}, "truth sincos=s: 2 columns are needed, separated by commas"),
        ({"hall": "s,c"}, "truth hall=s,c: 1 or 3 columns are needed"),
        ({"theta_e": "s,c"}, "truth theta_e=s,c: 1 columns are needed"),
        ({"sincos": "s,gone"}, "the column 'gone' of truth={'sincos': 's,gone'} holds no"),
    ],
)
def test_malformed_truths(truth, message):
    columns = {"s": np.sin(0.1 * K), "c": np.cos(0.1 * K), "gone": np.full(len(K), np.nan)}
    with pytest.raises(RecordError) as error:
        read_log(T | AXES | columns, truth=truth)
    assert message in str(error.value)


@pytest.mark.parametrize(("count", "named"), [(39, 40), (45, 40), (10, 11)])
def test_at_most_forty_columns_are_named_where_nothing_is_found(count, named):
    columns = T | {f"signal {n}": np.sin(K + n) for n in range(count)}
    with pytest.raises(RecordError) as error:
        read_log(columns)
    listing = str(error.value).partition("among its columns: ")[2].partition(". Name the")[0]
    assert len(listing.split(", ")) == named


def test_a_truth_of_one_column_is_not_scaled():
    true = Truth("theta_e", ("angle",))
    np.testing.assert_array_equal(true.centre, [0.0, 0.0])
    np.testing.assert_array_equal(true.size, [1.0, 1.0])
    assert not true.guessed
