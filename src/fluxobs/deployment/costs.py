"""Cost of one sample on emulated processors, counted by `make pil` and shipped as costs.json."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import resources
from typing import Any


def read_costs() -> dict[str, Any]:
    """Return the counts that `tests/firmware/processor/replay.py --write` wrote."""
    text = (resources.files(__package__) / "costs.json").read_text(encoding="utf-8")
    costs: dict[str, Any] = json.loads(text)
    return costs


def cost_table(costs: Mapping[str, Any]) -> str:
    """Return the costs as a Markdown table."""
    head = "| | instructions, mean | most | bound | code [bytes] | state [bytes] | stack [bytes] |"
    rows = [
        f"| {build['name']} | {build['mean']} | {build['most']} | {build.get('bound') or ''} "
        f"| {build['code']} | {build['state']} | {build['stack']} |"
        for build in costs["builds"]
    ]
    return "\n".join([head, "|---|---|---|---|---|---|---|", *rows, "", f"{costs['compiler']}."])


def task_table(costs: Mapping[str, Any]) -> str:
    """Return the costs of an interrupt and a slower task as a Markdown table."""
    head = (
        "| | interrupt: mean | most | bound | stack [bytes] | task: mean | most | bound "
        "| stack [bytes] |"
    )
    rows = [
        f"| {build['name']} | {build['mean']} | {build['most']} | {build.get('bound') or ''} "
        f"| {build['stack']} | {build['learn_mean']} | {build['learn_most']} "
        f"| {build.get('learn_bound') or ''} | {build['learn_stack']} |"
        for build in costs["builds"]
    ]
    return "\n".join([head, "|---|---|---|---|---|---|---|---|---|", *rows])
