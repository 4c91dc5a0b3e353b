"""Replay the record of this export with both units and compare every output bit for bit.

    python test/check.py          # needs fmpy, from PyPI

The exit code is 0 if all outputs are equal, also after a state was saved, serialised and restored
half-way.
"""

import csv
import json
import platform
import shutil
import sys
from importlib.metadata import version
from pathlib import Path

import fmpy
from fmpy import fmi2, fmi3
from fmpy.validation import validate_fmu

HERE = Path(__file__).resolve().parent
INPUTS = 4


def read_record():
    with (HERE / "record.csv").open(newline="") as text:
        rows = list(csv.reader(text))
    return rows[0], [[float(cell) for cell in row] for row in rows[1:]]


def save(unit, three):
    """Return the state in bytes."""
    state = unit.getFMUState() if three else unit.getFMUstate()
    kept = unit.serializeFMUState(state) if three else unit.serializeFMUstate(state)
    (unit.freeFMUState if three else unit.freeFMUstate)(state)
    return kept


def restore(unit, three, kept):
    """Set the state from bytes."""
    state = unit.deserializeFMUState(kept) if three else unit.deSerializeFMUstate(kept)
    (unit.setFMUState if three else unit.setFMUstate)(state)
    (unit.freeFMUState if three else unit.freeFMUstate)(state)


def replay(path):
    """Return the number of rows, and the number of rows that differ."""
    names, rows = read_record()
    description = fmpy.read_model_description(path, validate=True)
    step = float(description.defaultExperiment.stepSize)
    folder = fmpy.extract(path)
    try:
        three = description.fmiVersion == "3.0"
        unit = (fmi3.FMU3Slave if three else fmi2.FMU2Slave)(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="check",
        )
        unit.instantiate()
        if not three:
            unit.setupExperiment()
        unit.enterInitializationMode()
        unit.exitInitializationMode()
        number = {one.name: one.valueReference for one in description.modelVariables}
        given = [number[name] for name in names[:INPUTS]]
        found = [number[name] for name in names[INPUTS:-1]]
        valid = [number[names[-1]]]
        put = unit.setFloat64 if three else unit.setReal
        get = unit.getFloat64 if three else unit.getReal
        different = 0
        for k, row in enumerate(rows):
            if k == len(rows) // 2:  # a state saved as bytes must survive a reset
                kept = save(unit, three)
                unit.reset()
                restore(unit, three, kept)
            put(given, row[:INPUTS])
            unit.doStep(currentCommunicationPoint=k * step, communicationStepSize=step)
            result = list(get(found)) + [float(x) for x in unit.getBoolean(valid)]
            same = all(
                a == b or (a != a and b != b) for a, b in zip(result, row[INPUTS:], strict=True)
            )
            different += not same
        unit.terminate()
        unit.freeInstance()
        return len(rows), different
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def main():
    results = []
    for path in sorted(HERE.parent.glob("*.fmu")):
        rows, different = replay(path)
        problems = validate_fmu(str(path))
        if problems:
            sys.exit(f"{path.name}: {problems[0]}")
        results.append(
            {
                "what": f"{path.name}, its binary for {fmpy.platform}",
                "with": "the outputs of the library in double precision, bit for bit",
                "by": f"FMPy {version('fmpy')} on {platform.machine()}",
                "rows": rows,
                "different": different,
            }
        )
    if "--json" in sys.argv:
        print(json.dumps(results))
    else:
        for one in results:
            print(f"{one['what']}: {one['rows'] - one['different']} of {one['rows']} rows equal")
    return 1 if not results or any(one["different"] for one in results) else 0


if __name__ == "__main__":
    sys.exit(main())
