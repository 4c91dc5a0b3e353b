"""The summary of a run as numbers and strings for scripts."""

from __future__ import annotations

import math
from typing import Any

from ..estimation.learning import parameters
from ..estimation.run import LogRun
from ..estimation.truth import TruthFit


def facts(result: LogRun, warnings: list[str], truth: TruthFit | None) -> dict[str, Any]:
    """Return the summary of a run as a mapping for JSON; in SI units, angles in radians."""
    statistics, log = result.statistics, result.log
    valid = statistics.valid
    means = {name: total / valid for name, total in statistics.sums.items()} if valid else {}
    first_valid = statistics.first_valid
    data: dict[str, Any] = {
        "log": str(log.path),
        "rows": statistics.rows,
        "sample_time": log.sample_time,
        "frame": log.frame,
        "lag": log.layout.lag,
        "lag_weights": None
        if result.lag is None
        else {f"{lag:g}": weight for lag, weight in result.lag.weights.items()},
        "columns": dict(log.names),
        "unknowns": list(result.unknowns),
        "valid_share": valid / statistics.rows,
        "first_valid": None if first_valid is None else first_valid - statistics.start,
        "drift": [means[f"drift_{port}"] for port in result.machine.ports] if means else None,
        "parameters": _parameters(result),
        "budget": _budget(result),
        "quality": {
            name: {"rows": entry.rows, "stretches": entry.count, "first": entry.stretches[:10]}
            for name, entry in statistics.quality.marked.items()
        },
        "not_valid": {
            reason: count / statistics.rows for reason, count in statistics.not_valid.items()
        },
        "error": None,
        "truth": None,
        "notes": list(log.notes),
        "warnings": warnings,
    }
    if statistics.scored:
        data["error"] = {
            "rows": statistics.scored,
            "rms": statistics.rms_error,
            "most": statistics.error_max,
            "mean": statistics.error / statistics.scored,
        }
    if truth is not None:
        data["truth"] = {
            "channel": truth.channel,
            "pole_pairs": truth.pole_pairs,
            "parameters": {
                parameter.name: {
                    "value": parameter.value,
                    "std": parameter.std,
                    "unit": parameter.unit,
                }
                for parameter in truth.parameters
            },
            "rms": truth.rms if math.isfinite(truth.rms) else None,
            "most": truth.most if math.isfinite(truth.most) else None,
            "words": list(truth.words),
        }
    return data


def _budget(result: LogRun) -> dict[str, dict[str, float]] | None:
    """Return the contributions to the standard deviations: rad, rad/s, Wb, N m."""
    if result.budget is None:
        return None
    return {
        contribution.name: {
            "theta_e": contribution.std,
            "speed_e": contribution.speed,
            "flux": contribution.flux,
            "torque": contribution.torque,
        }
        for contribution in result.budget.contributions
    }


def _parameters(result: LogRun) -> dict[str, Any]:
    if result.adaptive is None or result.learnt is None:
        return {}
    return {
        parameter.name: {
            "value": parameter.value,
            "std": parameter.std,
            "unit": parameter.unit,
            "given": parameter.assumed,
            "told": parameter.told,
        }
        for parameter in parameters(result.adaptive, result.learnt)
    }
