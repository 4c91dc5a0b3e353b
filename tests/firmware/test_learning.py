"""Compares the learner in C with its readable twin in Python, number by number."""

from __future__ import annotations

import subprocess
from dataclasses import replace

import numpy as np
import pytest

from support.compiling import build_program
from support.firmware import FIRMWARE, HARNESS, firmware_objects
from support.learning_twin import ASYMMETRY, COUNT, INVERTER, OFFSET, LearningTwin, Settings

ROWS, H = 6000, 0.004  # sample time over memory
STD = np.array([0.2, 0.5, 0.1, 0.1, 0.03, 0.03, 0.01, 0.01, 0.1, 0.1])
SETTINGS = Settings(
    h=H,
    L=0.3,
    saliency=0.0,
    psi=0.9,
    std=STD,
    inverter_mean=0.02,
    volt=H,
    over_rated=1.0,
    through_L=1e-4,
    unmodelled=0.05,
    slow=0.003,
    plausible=0.5,
    sample_time=1e-4,
    resistance=0.6,
    lag_std=1e-5,
    delay_std=2e-5,
    current_gain_std=0.01,
    magnet_error=0.01,
)


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    made = tmp_path_factory.mktemp("learner") / "learner"
    parts = ("", "_map", "_triangle", "_candidates", "_learning", "_relation", "_adaptive")
    objects = firmware_objects(FIRMWARE / f"fluxobs{part}.c" for part in parts)
    sources = [HARNESS / "learner.c", *objects]
    build_program(["gcc"], ["-std=c99", "-O1", "-Wall", "-Werror", f"-I{FIRMWARE}"], sources, made)
    return made


def record(settings, jump=0.0, at=12.0, stop=False, inverter=0.05, noise=0.01, ripple=0.0):
    """Return (volt-seconds, effects, current, roughness, knee) of a drive with loads, reversals."""
    rng = np.random.default_rng(3)
    t = H * np.arange(ROWS + 1)
    speed = np.interp(t, [0, 6, 8, 14, 16, 24], [12, 12, -8, -8, 20, 20])
    if stop:
        speed *= np.interp(t, [0, 9, 9.5, 11, 11.5, 24], [1, 1, 0, 0, 1, 1])
    theta = np.concatenate([[0.4], 0.4 + np.cumsum(H * (speed[1:] + speed[:-1]) / 2)])[: ROWS + 1]
    load = np.interp(t, [0, 2, 2.1, 5, 5.1, 10, 10.1, 24], [0.3, 0.3, 1, 1, -0.4, -0.4, 0.8, 0.8])
    along = 0.2 * settings.saliency * 3 + ripple * (-1.0) ** np.arange(ROWS + 1)
    i = (along + 1j * load) * np.exp(1j * theta)
    psi = 1.0 + settings.saliency * (i * np.exp(-1j * theta)).real
    flux = settings.L * i + psi * np.exp(1j * theta)
    mean = (i[1:] + i[:-1]) / 2
    sign = np.tanh(mean.real / 0.05) + 1j * np.tanh(mean.imag / 0.05)
    drift = 0.1 - 0.05j + np.where(t[1:] > at, jump, 0)
    # The assumed resistance is too small by a third of a std.
    v = np.diff(flux) + 0.3 * STD[1] * 0.2 * H * mean + inverter * H * sign - H * drift
    effect = np.zeros((ROWS, COUNT), complex)
    effect[:, 1] = -STD[1] * 0.2 * H * mean
    effect[:, INVERTER] = -STD[INVERTER] * H * sign
    effect[:, INVERTER + 1] = -STD[INVERTER + 1] * H * np.tanh(mean.real) - 1j * H * 0.1 * np.tanh(
        mean.imag
    )
    effect[:, OFFSET] = STD[OFFSET] * 0.2 * H
    effect[:, OFFSET + 1] = 1j * STD[OFFSET + 1] * 0.2 * H
    effect[:, ASYMMETRY] = STD[ASYMMETRY] * np.diff(flux).conj()
    effect[:, ASYMMETRY + 1] = 1j * STD[ASYMMETRY + 1] * np.diff(flux).conj()
    noisy = i[1:] + noise * (rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS))
    knee = rng.uniform(0, 1, ROWS)
    return flux[0], v, effect, noisy, knee


def pairs(z):
    return np.stack([np.real(z), np.imag(z)], axis=-1)


@pytest.mark.parametrize(
    ("settings", "changes"),
    [
        (SETTINGS, {}),
        (replace(SETTINGS, saliency=-0.2), {}),
        (SETTINGS, {"jump": 0.6}),  # The drift returns to its prior.
        (SETTINGS, {"jump": 1.5, "at": 0.35}),  # Too early for a return to the prior.
        (SETTINGS, {"jump": 0.6, "at": 0.8}),  # Just late enough for a return.
        (SETTINGS, {"noise": 0.0, "inverter": 0.0}),
        (SETTINGS, {"stop": True}),  # Time ends the blocks.
        (replace(SETTINGS, saliency=-0.2), {"stop": True, "ripple": 0.2}),  # Direction at rest.
        (replace(SETTINGS, inverter_mean=0.0), {"inverter": -0.03}),  # No inverter adds voltage.
        (replace(SETTINGS, slow=0.5), {}),  # Parameters are forgotten.
    ],
    ids=[
        "plain",
        "salient",
        "jump",
        "early",
        "late",
        "quiet",
        "stop",
        "ripple",
        "negative",
        "forgets",
    ],
)
def test_c_is_its_twin(program, settings, changes):
    first, v, effect, current, knee = record(settings, **changes)
    stds = np.array([0.05, 0.05, 0.3, 0.3])
    theta = float(np.angle(first - settings.L * current[0]))
    numbers = [
        *(getattr(settings, name) for name in ("h", "L", "saliency", "psi", "inverter_mean")),
        *(getattr(settings, name) for name in ("volt", "over_rated", "through_L", "unmodelled")),
        *(settings.slow, settings.plausible, settings.sample_time, settings.resistance),
        *(settings.lag_std, settings.delay_std, settings.current_gain_std, settings.magnet_error),
        *settings.std,
        *(first.real, first.imag, 0.0, 0.0, *stds, theta, ROWS),
    ]
    samples = np.concatenate(
        [
            *(pairs(v), pairs(effect).reshape(ROWS, -1), pairs(current)),
            *(np.full((ROWS, 1), 0.8), knee[:, None]),
        ],
        axis=1,
    )
    given = np.concatenate([numbers, samples.ravel()]).astype(float)
    done = subprocess.run([program], input=given.tobytes(), capture_output=True, check=False)
    assert done.returncode == 0
    found = np.frombuffer(done.stdout).reshape(ROWS, 8 + COUNT)

    twin = LearningTwin(settings, pairs(first), np.zeros(2), stds, theta)
    expected = np.empty_like(found)
    for k in range(ROWS):
        learnt = twin.p @ pairs(effect[k])
        volts = pairs(v[k]) + learnt
        f, p = twin.sample(volts, pairs(effect[k]), pairs(current[k]), 0.8, knee[k])
        expected[k] = *f, *p, twin.level, twin.contradiction, twin.across, twin.turning
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)
    assert np.abs(found[-1, 4:-4]).max() > 0.1  # the parameters have changed
