"""Damaged and hostile logs: every one is read, or refused with a FluxobsError that names the file.

    python tests/logs/fuzz_readers.py [--cases 4000] [--seed 1] [--keep FOLDER]

Takes the files of the corpus, spoils bytes, cuts, doubles, and swaps numbers for others that no
instrument writes, and reads the result, with a bound on time and memory. Ends with 1 and keeps the
file if something else happens: another exception, a crash, a hang, more memory than allowed. The
same seed makes the same files.
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
#: A file of 200 kB may take this long and this much memory [s, bytes].
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
WORDS = [
    b"\x00" * 8,
    b"\xff" * 8,
    b"\x7f\xff\xff\xff",
    b"\xff\xff\xff\x7f",
    b"\n",
    b";;;;",
    b"\r",
    b'"',
]


def spoilt(content: bytes, chance: random.Random) -> bytes:
    """The content with one to four injuries."""
    made = bytearray(content)
    for _ in range(chance.randint(1, 4)):
        if not made:
            break
        at = chance.randrange(len(made))
        # Heads say most, ends of zip files too.
        at = chance.choice([at, at % 400, len(made) - 1 - at % min(400, len(made))])
        kind = chance.randrange(7)
        if kind == 0:
            del made[at:]
        elif kind == 1:
            for _ in range(chance.randint(1, 20)):
                made[min(at + chance.randrange(50), len(made) - 1)] = chance.randrange(256)
        elif kind == 2:
            del made[at : at + chance.randint(1, 2000)]
        elif kind == 3:
            made[at:at] = made[at : at + chance.randint(1, 2000)]
        elif kind == 4:
            word = chance.choice(WORDS)
            made[at : at + len(word)] = word
        elif kind == 5:
            found = list(re.finditer(rb"-?\d+\.?\d*", made[at : at + 400]))
            if found:
                one = chance.choice(found)
                made[at + one.start() : at + one.end()] = chance.choice(NUMBERS)
        else:
            made[at:at] = chance.randbytes(chance.randint(1, 64))
    return bytes(made)


def case(seed: int, number: int) -> tuple[str, bytes]:
    """Name of the file in the corpus, and what became of it."""
    chance = random.Random(f"{seed} {number}")
    source = chance.choice(sorted(CORPUS.iterdir()))
    return source.name, spoilt(source.read_bytes(), chance)


def read(path: Path) -> None:
    """What every command does with a log."""
    from fluxobs.logs import read_log

    stem = path.name.split(".")[0]
    preset = PRESETS.get(stem.partition("_")[2] or stem)
    for one in read_log(path, preset=preset).aligned():
        assert one.voltage.shape == one.current.shape


def work(seed: int, numbers: list[int], folder: str, said: multiprocessing.Queue) -> None:
    """Reads its cases one by one; says before each which it is, and after it what was wrong."""
    from fluxobs import FluxobsError

    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    for number in numbers:
        name, content = case(seed, number)
        path = Path(folder) / f"{number}_{name}"
        path.write_bytes(content)
        said.put((number, "begun"))
        signal.alarm(SECONDS)  # ends the process: nothing in the readers can hold it up
        wrong = ""
        try:
            read(path)
        except FluxobsError as error:
            if path.name not in str(error):
                wrong = f"the error does not name the file: {error}"
        except BaseException:
            wrong = traceback.format_exc(limit=-3)
        signal.alarm(0)
        said.put((number, wrong))
        if not wrong:
            path.unlink()
    said.put((-1, "done"))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for files that were not read well")
    options = parser.parse_args()
    folder = options.keep or Path(tempfile.mkdtemp(prefix="fluxobs-fuzz-"))
    folder.mkdir(parents=True, exist_ok=True)
    context = multiprocessing.get_context("spawn")
    left, found = list(range(options.cases)), dict[int, str]()
    while left:
        said = context.Queue()
        process = context.Process(target=work, args=(options.seed, left, str(folder), said))
        process.start()
        now = -1
        while True:
            try:
                number, word = said.get(timeout=1)
            except Exception:
                if process.is_alive():
                    continue
                hung = process.exitcode == -signal.SIGALRM
                found[now] = (
                    f"hangs: {SECONDS} s" if hung else f"ends the process: {process.exitcode}"
                )
                break
            if number < 0:
                now = -2
                break
            now = number
            if word and word != "begun":
                found[number] = word
        process.join()
        left = [] if now == -2 else [number for number in left if number > now]
    for number, word in found.items():
        print(f"{folder}/{number}_{case(options.seed, number)[0]}: {word}\n")
    print(f"{options.cases} spoilt logs, {len(found)} not read or refused as they should be")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
