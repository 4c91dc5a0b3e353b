"""The error budget of a run: which assumption contributes how much to the errors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array, runs
from ..machines import RotatingMachine
from ..smoothing.assumptions import ITEMS, stated_items
from ..smoothing.record import QUANTITIES, SHARES

#: Stretches at the borders of two windows are one if they are closer than this [s].
MERGED = 0.01
#: Names of the items: those of ITEMS, then what no assumption explains.
NAMES: tuple[str, ...] = (*(item.name for item in ITEMS), "calibration", "smoother", "noise")
CALIBRATION = NAMES.index("calibration")
#: Columns of the shares of assumptions that belong to each item.
_GROUPS = [
    *([SHARES.index(name) for name in item.assumptions] for item in ITEMS),
    [],  # common scales are no assumptions of the smoother
    *([SHARES.index(name)] for name in ("smoother", "noise")),
]


#: Advice that lowers σ by a smaller share is not worth a measurement.
LEAST_GAIN = 0.1
#: What makes the common scales of voltages and currents better known.
CALIBRATE = "calibrate one voltage and one current against a reference"


def item_shares(shares: Array) -> Array:
    """Return variances by item from those by assumption; (..., len(SHARES)) → (..., len(NAMES)).

    Correlations count for both assumptions by half, so a share can be negative; such a share
    counts as zero.
    """
    columns = [shares[..., group].sum(axis=-1) for group in _GROUPS]
    return np.asarray(np.maximum(np.stack(columns, axis=-1), 0.0))


@dataclass(frozen=True)
class Contribution:
    """Contribution of an item to the standard deviations, rms over the valid rows.

    Attributes
    ----------
    name : str
    std : float
        Of the position [rad].
    speed, flux, torque : float
        Of the electrical speed [rad/s], of a component of the flux [Wb], of the torque [N m].
    remedy : str
        What makes it smaller; empty if nothing can be measured.
    """

    name: str
    std: float
    speed: float
    flux: float
    torque: float
    remedy: str


@dataclass
class Budget:
    """Error budget of position, speed, flux and torque, collected over a run.

    Attributes
    ----------
    torque_factor : float
        Torque [N m] per flux × current [W s].
    inductance : str
        Name of the only inductance of a machine without saliency, else an empty string.
    stated : list of str
        Items whose standard deviation somebody states; nothing is advised about them.
    rows : float
        Number of valid rows.
    variances : (len(QUANTITIES), items) ndarray
        Sum over the valid rows of each item's variance.
    t, series : lists of ndarray
        Times [s] and variances of the items, (n, len(QUANTITIES), items), thinned out for the
        picture; NaN where no row is valid.
    misfit : float
        Mean square of the normalised innovations of the smoother; NaN if it did not run.
    stretches : list of (float, float)
        Start and end of each stretch that does not fit its surroundings [s].
    contradiction : str
        Item of the assumption that the log contradicts, or an empty string.
    unfit : int
        Number of rows in these stretches.
    wrong_inductance : float
        Probability that the inductance of the machine file is wrong beyond its prior.
    """

    torque_factor: float = 1.0
    inductance: str = ""
    stated: list[str] = field(default_factory=list)
    rows: float = 0.0
    variances: Array = field(default_factory=lambda: np.zeros((len(QUANTITIES), len(NAMES))))
    t: list[Array] = field(default_factory=list)
    series: list[Array] = field(default_factory=list)
    misfit: float = float("nan")
    stretches: list[tuple[float, float]] = field(default_factory=list)
    contradiction: str = ""
    unfit: int = 0
    wrong_inductance: float = 0.0

    @classmethod
    def for_machine(cls, machine: RotatingMachine, given: Iterable[str]) -> Self:
        """Return an empty budget of a machine; `given` are the names of stated priors."""
        names = machine.inductance_names
        return cls(
            1.5 * machine.n_p,
            names[0] if len(names) == 1 else "",
            stated_items(machine, given),
        )

    def add_stretches(self, t: Array, doubtful: NDArray[np.bool_]) -> None:
        """Add the stretches of consecutive doubtful rows at times `t`."""
        self.unfit += int(doubtful.sum())
        for start, end in runs(doubtful):
            first, last = float(t[start]), float(t[end - 1])
            if self.stretches and start == 0 and first - self.stretches[-1][1] < MERGED:
                first = self.stretches.pop()[0]
            self.stretches.append((first, last))

    def add(self, t: Array, shares: Array, scales: Array, valid: Array, stride: int) -> None:
        """Add blocks.

        Parameters
        ----------
        t : (blocks,) ndarray
        shares : (blocks, len(QUANTITIES), len(SHARES)) ndarray
            Variances by assumption.
        scales : (blocks, len(QUANTITIES)) ndarray
            Variances by the common scales of voltages and currents.
        valid : (blocks,) ndarray
            Numbers of valid rows.
        stride : int
            Of the blocks that the picture shows.
        """
        items = item_shares(shares)
        items[:, :, CALIBRATION] = scales
        self.add_items(t, items, valid, stride)

    def add_items(self, t: Array, items: Array, valid: Array, stride: int = 1) -> None:
        """Add (n, len(QUANTITIES), len(NAMES)) variances by item; see :meth:`add`."""
        items[:, QUANTITIES.index("torque")] *= self.torque_factor**2
        self.rows += float(valid.sum())
        self.variances = self.variances + (valid[:, None, None] * items).sum(axis=0)
        self.t.append(t[::stride])
        known = (valid > 0)[:, None, None]
        self.series.append(np.where(known, items, np.nan)[::stride])

    @property
    def names(self) -> list[str]:
        """Names of the items as in the machine file; empty for one that the machine lacks."""
        if not self.inductance:
            return list(NAMES)
        other = {"L_d": self.inductance, "L_q": ""}
        return [other.get(name, name) for name in NAMES]

    def of(self, quantity: str) -> Array:
        """Return the standard deviations of a quantity by item, rms over the valid rows."""
        variances = self.variances[QUANTITIES.index(quantity)]
        return np.sqrt(variances / self.rows) if self.rows else np.full(len(NAMES), np.nan)

    @property
    def std(self) -> float:
        """Standard deviation of the position, rms over the valid rows [rad]; NaN without any."""
        return float(np.sqrt((self.of("theta_e") ** 2).sum()))

    @property
    def contributions(self) -> list[Contribution]:
        """Contributions, the largest of the position first."""
        if not self.rows:
            return []
        remedies = {item.name: item.remedy for item in ITEMS} | {"calibration": CALIBRATE}
        names = self.names
        position, speed, flux, torque = [self.of(quantity) for quantity in QUANTITIES]
        listed = [
            Contribution(
                names[n],
                float(position[n]),
                float(speed[n]),
                float(flux[n]),
                float(torque[n]),
                "" if name in self.stated else remedies.get(name, ""),
            )
            for n, name in enumerate(NAMES)
            if names[n]
        ]
        return sorted(listed, key=lambda contribution: -contribution.std)

    @property
    def advice(self) -> str:
        """What to measure next, and what it gains; empty without a valid row."""
        for contribution in self.contributions:
            rest = np.sqrt(max(self.std**2 - contribution.std**2, 0.0))
            if contribution.remedy and rest < (1 - LEAST_GAIN) * self.std:
                return (
                    f"{contribution.remedy}: σ {np.degrees(rest):.2g}° instead of "
                    f"{np.degrees(self.std):.2g}°"
                )
        return ""

    def layers(self, count: int) -> tuple[Array, list[str], list[Array]]:
        """Return times, names and variances of the position's largest items, and of the others.

        Times in [s], variances in [rad^2], NaN where no row is valid. Nothing without a valid row.
        """
        series = self.columns()
        names = [contribution.name for contribution in self.contributions]
        if not names:
            return np.zeros(0), [], []
        others = np.stack([series[name] for name in names[count:]]).sum(axis=0)
        layers = [series[name] for name in names[:count]]
        return series["t"], [*names[:count], "others"], [*layers, others]

    def columns(self, quantity: str = "theta_e") -> dict[str, Array]:
        """Return the series: t [s], and each item's variance of theta_e, speed_e, flux or torque.

        The unit is the square of that of :class:`Contribution`.
        """
        if not self.t:
            return {}
        series = np.concatenate(self.series)[:, QUANTITIES.index(quantity)]
        names = {name: series[:, n] for n, name in enumerate(self.names) if name}
        return {"t": np.concatenate(self.t)} | names
