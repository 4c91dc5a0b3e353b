"""A run with its summary, its warnings, the errors of its truth and the check of its log."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ..checking.findings import Check
from ..checking.search import check_log
from ..errors import FluxobsError
from ..estimation.learning import parameters
from ..estimation.run import LogRun
from ..estimation.truth import TruthFit, fit_truth
from ..machines import Machine, RotatingMachine
from ..machines.file_text import with_found
from .agreement import agreed
from .result_data import facts
from .summary import Row, as_text, summary_rows
from .warnings import warnings


@dataclass(frozen=True, eq=False)
class ExplainedRun(LogRun):
    """A run with its texts; it has the attributes of :class:`LogRun`."""

    @cached_property
    def summary_rows(self) -> list[Row]:
        """The results of the run as rows of label and value."""
        return summary_rows(self, self.checked, self.truth_fit)

    @property
    def summary(self) -> str:
        """The results of the run as a short table in text."""
        return as_text(self.summary_rows)

    @cached_property
    def warnings(self) -> list[str]:
        """Reasons to doubt the results, one or two sentences each."""
        return warnings(self, self.checked, self.truth_fit)

    @property
    def facts(self) -> dict[str, Any]:
        """Summary and warnings as numbers and strings that JSON can hold."""
        return facts(self, self.warnings, self.truth_fit)

    @cached_property
    def truth_fit(self) -> TruthFit | None:
        """Errors of the truth channel, fitted to the estimate; None without a truth channel."""
        samples = self.statistics.truth
        if samples is None or not isinstance(self.machine, RotatingMachine):
            return None
        return fit_truth(samples, self.machine)

    @cached_property
    def checked(self) -> Check | None:
        """Result of :func:`fluxobs.check` on the log, without what the estimate contradicts.

        None if the log cannot be checked.
        """
        if not isinstance(self.machine, RotatingMachine):
            return None
        try:
            found = self.examined or check_log(self.log, self.machine, scales=self.scales)
            return agreed(found, self)
        except FluxobsError:  # too many gaps
            return None

    @property
    def firmware(self) -> str | None:
        """Why this observer cannot be exported; None if it can be exported or has no C code."""
        plain = self.plain
        if plain is None:
            return None
        machine = self.rotor
        missing = []
        if machine.flux_base(1.0) is None:
            missing.append(f"psi_f ({plain.flux_base:.3g} here)")
        if not machine.rated_current:
            missing.append(f"rated_current ({self.scales.current:.3g} here)")
        if missing:
            return f"To export this observer, add {' and '.join(missing)} to the machine file."
        if machine.inverter is not None and self.adaptive is None:
            return (
                "In firmware, the observer for the drift alone does not correct the inverter's "
                "voltage: compensate it in the drive, or export with --unknowns drift,inverter."
            )
        return None

    def export_command(self, machine: str) -> str | None:
        """Return the command that exports this observer for the machine named `machine`."""
        plain = self.plain
        if plain is None or self.firmware is not None:
            return None
        unknowns = "drift" if self.adaptive is None else ",".join(self.unknowns)
        options = f" --unknowns {unknowns}"
        priors = dict(self.priors)
        if self.adaptive is not None and self.adaptive.inverter_std > 0:
            priors["inverter"] = self.adaptive.inverter_std  # its default depends on the log
        options += "".join(f" --prior {name}={std!r}" for name, std in priors.items())
        return (
            f"fluxobs export --machine {shlex.quote(machine)}{options} "
            f"--sample-time {plain.sample_time!r} --memory {plain.memory!r} "
            f"--current-noise {plain.current_noise!r} --drift-prior {plain.drift_prior!r} "
            f"--out FOLDER"
        )

    @property
    def found(self) -> dict[str, tuple[float, float]]:
        """Identified parameters: name in the machine file → (value, standard deviation)."""
        if self.adaptive is None or self.learnt is None:
            return {}
        names = {"magnet flux": "psi_f", "resistance": "R_s", "inverter": "inverter_voltage"}
        return {
            names[parameter.name]: (parameter.value, parameter.std)
            for parameter in parameters(self.adaptive, self.learnt)
            if parameter.told
        }

    @property
    def machine_learnt(self) -> Machine:
        """The machine with identified parameters and with standard deviations for the next log."""
        if self.adaptive is None or not self.found:
            return self.machine
        machine = with_found(self.rotor, self.found)
        if "inverter_voltage" not in self.found:
            return machine
        return machine.with_values(inverter_current=float(f"{self.adaptive.inverter_current:.6g}"))

    def __str__(self) -> str:
        return "\n".join([self.summary, *(f"Warning: {text}" for text in self.warnings)])
