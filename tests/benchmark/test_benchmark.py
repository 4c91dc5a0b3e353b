"""The benchmark: suite, entrants, scores."""

import json
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import polars as pl
import pytest

import fluxobs as fluxobs_api
from fluxobs.benchmark import drives, entrants, loop, measured, programs, scores, suite
from fluxobs.benchmark.report import markdown_table, text_table, write_report
from fluxobs.deployment.forms import build
from fluxobs.errors import FluxobsError
from fluxobs.machines.files import copy_example
from support.cli import fluxobs

LEAKY = """
import cmath


class Observer:
    def __init__(self, machine, sample_time):
        self.R, self.L, self.h = machine["R_s"], machine["L_s"], sample_time
        self.flux, self.last = 0j, 0j

    def step(self, voltage, current):
        u, i = complex(*voltage), complex(*current)
        if cmath.isfinite(u) and cmath.isfinite(i):
            self.flux += self.h * (u - self.R * (i + self.last) / 2 - 10 * self.flux)
            self.last = i
        return cmath.phase(self.flux - self.L * self.last), 0.3


class Cheating:
    def __init__(self, machine, sample_time):
        self.kind = machine["kind"]

    def estimate(self, voltage, current):
        return {"theta_e": np.zeros(len(voltage)), "valid": np.zeros(len(voltage), bool)}


class Neither:
    def __init__(self, machine, sample_time):
        pass
"""

IN_C = """
#include <math.h>
#include <stdlib.h>
typedef struct { double h, flux[2]; } observer;
void *observer_new(const char *machine, double h)
{
    observer *o = calloc(1, sizeof *o);
    o->h = machine[0] == '/' ? h : NAN;
    return o;
}
void observer_step(void *of, const double u[2], const double i[2], double out[5])
{
    observer *o = of;
    for (int k = 0; k < 2; k++)
        if (isfinite(u[k]) && isfinite(i[k]))
            o->flux[k] += o->h * (u[k] - 0.36 * i[k] - 10 * o->flux[k]);
    out[0] = atan2(o->flux[1], o->flux[0]);
    out[1] = NAN;
    out[2] = 1.0;
    out[3] = out[4] = NAN;
}
void observer_free(void *o) { free(o); }
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A suite of a single machine and course."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(suite, "MACHINES", ("servo-400w",))
        patch.setattr(suite, "COURSES", {"steady": {}})
        folder = tmp_path_factory.mktemp("suite") / "suite"
        written = suite.write_suite(folder, seed=3)
    assert [entry.errors for entry in written.entries] == list(suite.ERRORS)
    return suite.read_suite(folder)


def scored(text, made, **options):
    entrant = entrants.entrant(text, **options)
    return entrant, scores.score_entrant(entrant, made)


def test_a_seed_gives_the_same_drives(made):
    entry = next(entry for entry in made.entries if entry.errors == "data sheet")
    _, current = made.log(entry)
    again, other = (
        drives.simulated("servo-400w", "steady", 1, seed, suite.ERRORS["data sheet"])[0].current
        for seed in (3, 4)
    )
    np.testing.assert_array_equal(current[:, 0] + 1j * current[:, 1], again)
    assert not np.array_equal(again, other)


def test_the_truth_is_that_of_the_log(made):
    """The torque turns the drive as its speed says, and the speed is that of the angle."""
    truth = made.truth(made.entries[0])
    speed = np.gradient(np.unwrap(truth["theta_e"]), made.entries[0].sample_time)
    np.testing.assert_allclose(speed[5:-5], truth["speed_e"][5:-5], atol=2.0)


def test_our_observers(made):
    _, ours = scored("adaptive", made)
    assert [score.record for score in ours] == [entry.name for entry in made.entries]
    right = ours[0]
    assert right.rms_valid < np.radians(0.5)
    assert right.valid > 0.8
    assert right.within_2 > 0.95
    assert not right.sure_and_wrong
    assert right.torque < 0.05


def test_an_observer_in_python_is_causal(made, tmp_path):
    (tmp_path / "mine.py").write_text("import numpy as np\n" + LEAKY)
    entrant, found = scored(f"{tmp_path / 'mine.py'}:Observer", made)
    assert (entrant.name, entrant.track) == ("Observer", "causal")
    assert all(score.valid == 1.0 for score in found)
    assert 0 < found[0].rms < np.radians(40)
    assert found[0].speed is None
    assert found[0].within_1 is not None  # it states a standard deviation
    offline, blind = scored(f"{tmp_path / 'mine.py'}:Cheating", made)
    assert offline.track == "offline"
    assert [score.rms_valid for score in blind] == [None] * 3
    with pytest.raises(FluxobsError, match="neither step nor estimate"):
        entrants.entrant(f"{tmp_path / 'mine.py'}:Neither")
    with pytest.raises(FluxobsError, match="has no Nobody"):
        entrants.entrant(f"{tmp_path / 'mine.py'}:Nobody")


def test_an_entrant_sees_neither_the_future_nor_the_truth(made, tmp_path):
    """The voltage of a step is that of the interval before its sample."""
    seen = []

    class Watching:
        def __init__(self, machine, sample_time):
            seen.clear()

        def step(self, voltage, current):
            seen.append((*voltage, *current))
            return 0.0

    entrants._stepped(lambda machine, h: Watching({}, h), made, made.entries[0])
    voltage, current = made.log(made.entries[0])
    np.testing.assert_array_equal(np.array(seen)[1:, :2], voltage[:-1])
    np.testing.assert_array_equal(np.array(seen)[:, 2:], current)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no cross compiler: cc")
def test_a_shared_library_is_an_entrant(made, tmp_path):
    (tmp_path / "o.c").write_text(IN_C)
    library = tmp_path / "leaky.so"
    command = ["cc", "-shared", "-fPIC", "-O2", tmp_path / "o.c", "-o", library, "-lm"]
    subprocess.run(command, check=True)
    entrant, found = scored(str(library), made)
    assert (entrant.name, entrant.track) == ("leaky", "causal")
    assert found[0].rms < np.radians(40)
    assert found[0].interval is None
    assert found[0].valid == 1.0
    other = tmp_path / "empty.so"
    (tmp_path / "e.c").write_text("int nothing;\n")
    subprocess.run(["cc", "-shared", "-fPIC", tmp_path / "e.c", "-o", other], check=True)
    with pytest.raises(FluxobsError, match="observer_new"):
        entrants.entrant(str(other))


def test_a_folder_of_estimates(made, tmp_path):
    for entry in made.entries:
        truth = made.truth(entry)
        rows = len(truth["theta_e"])
        columns = {
            "theta_e": truth["theta_e"] + 0.01,
            "theta_e_std": np.full(rows, 0.01),
            "valid": np.arange(rows) > 99,
            "speed_e": truth["speed_e"] + 2.0,
            "torque": truth["torque"],
        }
        pl.DataFrame(columns).write_parquet(tmp_path / f"{entry.name}.parquet")
    with pytest.raises(FluxobsError, match="state the track"):
        entrants.entrant(str(tmp_path))
    entrant, found = scored(str(tmp_path), made, track="offline")
    score = found[0]
    assert score.rms == pytest.approx(0.01)
    assert score.within_1 == pytest.approx(1.0, abs=1e-6) or score.within_1 == 0.0
    assert (score.within_2, score.within_3) == (1.0, 1.0)
    assert score.first_valid == pytest.approx(100 * made.entries[0].sample_time)
    assert score.speed == pytest.approx(2.0)
    assert score.torque == pytest.approx(0.0)
    assert score.interval == pytest.approx(2 * scores.HALF_WIDTH * 0.01)
    summary = scores.summarise(entrant, found)
    assert [s.group for s in summary] == ["all", *suite.ERRORS]
    assert summary[0].rms == pytest.approx(np.degrees(0.01))
    assert "µs" in text_table(summary)
    assert markdown_table(summary).count("\n") == len(summary) + 2
    write_report(tmp_path / "out", made, [(entrant, found, summary)])
    table = pl.read_csv(tmp_path / "out" / "scores.csv")
    assert table["record"].to_list() == [entry.name for entry in made.entries]
    pl.DataFrame({"theta_e": [0.0]}).write_parquet(tmp_path / f"{made.entries[0].name}.parquet")
    with pytest.raises(FluxobsError, match=r"returns \(1,\), not \d+ rows"):
        scores.score_entrant(entrant, made)
    pl.DataFrame({"angle": [0.0]}).write_parquet(tmp_path / f"{made.entries[0].name}.parquet")
    with pytest.raises(FluxobsError, match="no column theta_e"):
        scores.score_entrant(entrant, made)


def test_the_interval_score_is_least_for_the_true_standard_deviation():
    error = np.abs(0.02 * np.random.default_rng(0).standard_normal(200_000))
    means = [scores.interval_score(error, std).mean() for std in (0.01, 0.02, 0.04)]
    assert means[1] < min(means[0], means[2])
    # The exact mean for a normal distribution: 2 σ φ(z) 2/α, with the quantile z.
    exact = 2 * 0.02 * np.exp(-(scores.HALF_WIDTH**2) / 2) / np.sqrt(2 * np.pi) * 2 / scores.ALPHA
    assert means[1] == pytest.approx(exact, rel=0.02)


def test_without_standard_deviations_the_best_constant_counts(made):
    _, found = scored("adaptive", made)
    silent = [replace(score, interval=None) for score in found]
    constant = scores.best_constant(silent)

    def mean(std):
        return np.mean([scores.interval_score(s.quantiles, std).mean() for s in silent])

    assert mean(constant) <= min(mean(0.8 * constant), mean(1.2 * constant)) + 1e-9


def test_suites_that_cannot_be_read(made, tmp_path):
    with pytest.raises(FluxobsError, match="no suite"):
        suite.read_suite(tmp_path)
    index = tmp_path / "index.json"
    index.write_text("[]")
    with pytest.raises(FluxobsError, match="malformed"):
        suite.read_suite(tmp_path)
    index.write_text(json.dumps({"version": 99, "seed": 1, "records": []}))
    with pytest.raises(FluxobsError, match="suite of version 99"):
        suite.read_suite(tmp_path)
    with pytest.raises(FluxobsError, match="exists"):
        suite.write_suite(made.folder)


def test_unknown_entrants():
    with pytest.raises(FluxobsError, match=r"'adaptiv' is unknown; did you mean 'adaptive'"):
        entrants.entrant("adaptiv")
    with pytest.raises(FluxobsError, match=r"No such file|nowhere"):
        entrants.entrant("nowhere.py:Observer")
    assert "sliding mode" in entrants.published()


def test_the_command(made, tmp_path):
    """A suite that exists is used; the table and the files have every entrant."""
    out = tmp_path / "scores"
    arguments = ("score", "plain", "adaptive", "--suite", str(made.folder), "--out", str(out))
    done = fluxobs(*arguments, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Suite 1, seed 3, 3 records.\nentrant ")
    assert [line.split()[0] for line in done.stdout.splitlines()[2::4]] == ["plain", "adaptive"]
    assert pl.read_csv(out / "scores.csv").height == 6
    assert (out / "summary.md").read_text("utf-8").startswith("Suite 1, seed 3, 3 records\n")
    again = fluxobs(*arguments, folder=tmp_path)
    assert again.returncode == 2
    assert "--force" in again.stderr
    unknown = fluxobs("score", "adaptiv", "--suite", str(made.folder), folder=tmp_path)
    assert unknown.returncode == 2
    assert "did you mean 'adaptive'" in unknown.stderr
    listed = fluxobs("score", "plain", "--suite", str(made.folder), "--json", folder=tmp_path)
    assert json.loads(listed.stdout)[0]["group"] == "all"


LEADING = """
import cmath


class Observer:
    \"\"\"An observer that knows when it does not know.\"\"\"

    def __init__(self, machine, sample_time):
        self.R, self.L, self.h, self.n = machine["R_s"], machine["L_s"], sample_time, 0
        self.flux, self.last = 0j, 0j

    def step(self, voltage, current):
        u, i = complex(*voltage), complex(*current)
        if cmath.isfinite(u) and cmath.isfinite(i):
            self.flux += self.h * (u - self.R * (i + self.last) / 2 - 20 * self.flux)
            self.last, self.n = i, self.n + 1
        return cmath.phase(self.flux - self.L * self.last), 0.1, self.n * self.h > 0.6
"""


@pytest.fixture
def one_machine(monkeypatch):
    """The closed loop with a machine, two courses and a kind of errors."""
    monkeypatch.setattr(loop, "MACHINES", ("pmsm-2kw2",))
    monkeypatch.setattr(loop, "ERRORS", {"right model": suite.ERRORS["right model"]})
    chosen = {name: loop.LOOP_COURSES[name] for name in ("load step", "reversal")}
    monkeypatch.setattr(loop, "LOOP_COURSES", chosen)


@pytest.mark.slow
def test_entrants_in_the_loop_of_a_drive(made, one_machine, tmp_path):
    """The adaptive observer holds the drive; an observer in Python is called sample by sample."""
    copy_example("pmsm-2kw2", made.folder / "machines")
    ours = loop.score_in_loop(entrants.entrant("adaptive"), made)
    assert [score.record for score in ours] == [
        "pmsm-2kw2-load-step-right-model-0",
        "pmsm-2kw2-reversal-right-model-0",
    ]
    assert all(score.lost < scores.LOST_DRIVE and score.valid > 0.6 for score in ours)
    assert all(score.rms_valid < np.radians(1.0) for score in ours)
    (tmp_path / "mine.py").write_text(LEADING)
    entrant = entrants.entrant(f"{tmp_path / 'mine.py'}:Observer")
    mine = loop.score_in_loop(entrant, made)
    # It states no speed: a phase-locked loop gives it one. It enters when it says so.
    assert all(0.5 < score.first_valid < 1.5 for score in mine)
    assert all(0 < score.speed < 60 for score in mine)
    again = loop.score_in_loop(entrant, made)
    assert [score.rms for score in again] == [score.rms for score in mine]
    with pytest.raises(FluxobsError, match="whole-log is not a causal observer"):
        loop.score_in_loop(entrants.entrant("whole-log"), made)


@pytest.mark.slow
def test_a_simulation_unit_is_an_entrant(made, tmp_path):
    """The unit that we export has the estimates of the observer from which it was made."""
    pytest.importorskip("fmpy")
    made = replace(made, entries=made.entries[:1])
    with pytest.MonkeyPatch.context() as patch:  # another test covers cross-compilers
        patch.setattr(build, "has_zig", lambda: False)
        fluxobs_api.export("servo-400w", 1e-4, tmp_path / "servo-400w", form="fmu")
    (tmp_path / "units").mkdir()
    unit = tmp_path / "units" / "servo-400w.fmi3.fmu"
    shutil.copy(next((tmp_path / "servo-400w").glob("*.fmi3.fmu")), unit)
    entrant, found = scored(str(tmp_path / "units"), made)
    assert (entrant.name, entrant.track) == ("units", "causal")
    _, plain = scored("plain", made)
    assert [score.record for score in found] == [score.record for score in plain]
    assert found[0].valid > 0.3
    assert found[0].rms_valid < np.radians(2.0)
    other = tmp_path / "drone-900kv.fmu"
    shutil.copy(unit, other)
    assert scored(str(other), made)[1] == []


RECIPE = """
source = "here"
licence = "any"
files = "*.csv"
unverified = ["everything"]
[machine]
kind = "surface-pmsm"
R_s = 0.36
L_s = 6e-4
n_p = 4
psi_f = 0.0125
rated_current = 12.0
[drive]
speed_e = 1256.0
torque = 0.8
J = 6e-5
dc_link = 48.0
[log]
sample_time = 1e-4
lag = -1
truth = { theta_mech = "theta" }
"""


def test_measured_logs_join_by_a_recipe(made, tmp_path):
    """A log whose voltages are a sample early, with a mechanical angle that wraps."""
    entry = made.entries[0]
    (u, i), truth = made.log(entry), made.truth(entry)
    early = np.concatenate([u[1:], u[-1:]])
    angle = (np.unwrap(truth["theta_e"]) / 4) % (2 * np.pi)
    columns = {"u_alpha": early[:, 0], "u_beta": early[:, 1]}
    columns |= {"i_alpha": i[:, 0], "i_beta": i[:, 1], "theta": angle}
    data = tmp_path / "data"
    data.mkdir()
    pl.DataFrame(columns).write_csv(data / "log1.csv")
    (tmp_path / "mine.toml").write_text(RECIPE)
    name, recipe = measured.read_recipe(str(tmp_path / "mine.toml"))
    written = measured.write_measured(tmp_path / "suite", name, recipe, data)
    again = suite.read_suite(tmp_path / "suite")
    assert again == written
    assert again.measured
    voltage, current = again.log(again.entries[0])
    np.testing.assert_allclose(voltage[1:-2], u[1:-2], atol=1e-9)
    np.testing.assert_allclose(current, i, atol=1e-9)
    difference = again.truth(again.entries[0])["theta_e"] - truth["theta_e"]
    np.testing.assert_allclose(np.exp(1j * difference), 1.0, atol=1e-9)
    entrant, found = scored("adaptive", again)
    assert found[0].rms_valid < np.radians(1.0)
    assert (found[0].speed, found[0].torque) == (None, None)
    assert scored("sliding mode", again)[1][0].rms > 0
    assert [s.group for s in scores.summarise(entrant, found)] == ["all"]
    with pytest.raises(FluxobsError, match=r"no \*\.csv; get the files from here"):
        measured.write_measured(tmp_path / "none", name, recipe, tmp_path / "units")
    with pytest.raises(FluxobsError, match="did you mean 'med2021-spmsm'"):
        measured.read_recipe("med2021-spm")
    (tmp_path / "bad.toml").write_text('source = "x"\n')
    with pytest.raises(FluxobsError, match="licence"):
        measured.read_recipe(str(tmp_path / "bad.toml"))
    with pytest.raises(FluxobsError, match="measured records cannot be run in closed loop"):
        loop.score_in_loop(entrants.entrant("adaptive"), again)


def test_shipped_recipes_can_be_read():
    assert measured.recipe_names() == ["med2021-spmsm"]
    _, recipe = measured.read_recipe("med2021-spmsm")
    assert recipe.unverified


def test_a_machine_with_a_flux_map_comes_with_its_inductances(tmp_path):
    path = copy_example("ipm-5kw6", tmp_path)
    fields = programs.fields_of(path)
    assert 0 < fields["L_d"] < fields["L_q"]
    assert fields["psi_f"] > 0
    assert pl.read_csv(fields["flux_map"]).height > 10


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("raise ValueError('no')", r"failed at .*bad\.py:6: ValueError: no"),
        ("return None", "step must return theta_e"),
        ("return (0.0,) * 7", "step must return theta_e"),
        ("return [[0.0, 1.0]]", "step must return theta_e"),
    ],
)
def test_an_entrant_that_fails_is_named_with_its_line(made, tmp_path, body, message):
    (tmp_path / "bad.py").write_text(
        "class Observer:\n    def __init__(self, machine, sample_time):\n        pass\n\n"
        f"    def step(self, voltage, current):\n        {body}\n"
    )
    with pytest.raises(FluxobsError, match=message):
        scored(f"{tmp_path / 'bad.py'}:Observer", made)


def test_options_of_a_new_suite_are_refused_for_an_existing_one(made, tmp_path):
    folder = str(made.folder)
    for options in (("--seed", "9"), ("--drives", "2"), ("--recipe", "med2021-spmsm")):
        done = fluxobs("score", "plain", "--suite", folder, *options, folder=tmp_path)
        assert done.returncode == 2, options
        assert "needs a new folder" in done.stderr
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("")
    done = fluxobs("score", "plain", "--suite", "other", folder=tmp_path)
    assert "contains thesis.tex; give a new folder" in done.stderr
