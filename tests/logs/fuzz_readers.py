"""Fuzz the readers: a damaged log must be read, or refused by a FluxobsError that names the file.

    python tests/logs/fuzz_readers.py [--cases 4000] [--seed 1] [--keep FOLDER]

Damage files of the corpus (change bytes, cut, duplicate, replace numbers by implausible ones) and
read them within limits of time and memory. If anything else happens (another exception, a crash, a
hang, too much memory), keep the file and exit with 1. A seed always makes the same files.
"""

from __future__ import annotations

import argparse
import multiprocessing
import random
import re
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from pathlib import Path

CORPUS = Path(__file__).parent / "corpus"
PRESETS = {"moteus": "moteus", "vesc-sampled": "vesc-sampled", "mesc": "mesc", "odrive": "odrive"}
#: Limits for a file of 200 kB [s, bytes].
SECONDS, MEMORY = 20, 3 << 30
NUMBERS = [
    b"1e308",
    b"-1e-320",
    b"nan",
    b"inf",
    b"",
    b"-",
    b"0x10",
    b"9" * 400,
    b"1,5",
    b"1e",
    b"\xff",
]
PATTERNS = [
    b"\x00" * 8,
    b"\xff" * 8,
    b"\x7f\xff\xff\xff",
    b"\xff\xff\xff\x7f",
    b"\n",
    b";;;;",
    b"\r",
    b'"',
]


def damage(content: bytes, rng: random.Random) -> bytes:
    """Return the content, damaged at one to four places."""
    damaged = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        if not damaged:
            break
        at = rng.randrange(len(damaged))
        # Headers, and the ends of zip files, are the most important places.
        at = rng.choice([at, at % 400, len(damaged) - 1 - at % min(400, len(damaged))])
        kind = rng.randrange(7)
        if kind == 0:
            del damaged[at:]
        elif kind == 1:
            for _ in range(rng.randint(1, 20)):
                damaged[min(at + rng.randrange(50), len(damaged) - 1)] = rng.randrange(256)
        elif kind == 2:
            del damaged[at : at + rng.randint(1, 2000)]
        elif kind == 3:
            damaged[at:at] = damaged[at : at + rng.randint(1, 2000)]
        elif kind == 4:
            pattern = rng.choice(PATTERNS)
            damaged[at : at + len(pattern)] = pattern
        elif kind == 5:
            numbers = list(re.finditer(rb"-?\d+\.?\d*", damaged[at : at + 400]))
            if numbers:
                number = rng.choice(numbers)
                damaged[at + number.start() : at + number.end()] = rng.choice(NUMBERS)
        else:
            damaged[at:at] = rng.randbytes(rng.randint(1, 64))
    return bytes(damaged)


def case(seed: int, number: int) -> tuple[str, bytes]:
    """Return the name of a file of the corpus, and its damaged content."""
    rng = random.Random(f"{seed} {number}")
    source = rng.choice(sorted(CORPUS.iterdir()))
    return source.name, damage(source.read_bytes(), rng)


def read(path: Path) -> None:
    """Read a log as every command does."""
    from fluxobs.logs import read_log

    stem = path.name.split(".")[0]
    preset = PRESETS.get(stem.partition("_")[2] or stem)
    for batch in read_log(path, preset=preset).aligned():
        assert batch.voltage.shape == batch.current.shape


def work(seed: int, numbers: list[int], folder: str, reports: multiprocessing.Queue) -> None:
    """Read cases one by one; report the start of each case, and then its failure."""
    from fluxobs import FluxobsError

    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    for number in numbers:
        name, content = case(seed, number)
        path = Path(folder) / f"{number}_{name}"
        path.write_bytes(content)
        reports.put((number, "begun"))
        signal.alarm(SECONDS)  # ends the process, even if a reader hangs
        failure = ""
        try:
            read(path)
        except FluxobsError as error:
            if path.name not in str(error):
                failure = f"the error does not name the file: {error}"
        except BaseException:
            failure = traceback.format_exc(limit=-3)
        signal.alarm(0)
        reports.put((number, failure))
        if not failure:
            path.unlink()
    reports.put((-1, "done"))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for the files that fail")
    options = parser.parse_args()
    folder = options.keep or Path(tempfile.mkdtemp(prefix="fluxobs-fuzz-"))
    folder.mkdir(parents=True, exist_ok=True)
    context = multiprocessing.get_context("spawn")
    pending, failures = list(range(options.cases)), dict[int, str]()
    while pending:
        reports = context.Queue()
        process = context.Process(target=work, args=(options.seed, pending, str(folder), reports))
        process.start()
        current = -1
        while True:
            try:
                number, report = reports.get(timeout=1)
            except Exception:
                if process.is_alive():
                    continue
                timed_out = process.exitcode == -signal.SIGALRM
                failures[current] = (
                    f"hangs: {SECONDS} s" if timed_out else f"ends the process: {process.exitcode}"
                )
                break
            if number < 0:
                current = -2
                break
            current = number
            if report and report != "begun":
                failures[number] = report
        process.join()
        pending = [] if current == -2 else [number for number in pending if number > current]
    for number, report in failures.items():
        print(f"{folder}/{number}_{case(options.seed, number)[0]}: {report}\n")
    print(f"{options.cases} damaged logs, {len(failures)} neither read nor properly refused")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
