"""Wall time of `fluxobs reproduce`, including compilation; each run is a new process."""

import subprocess
import sys
import tempfile
import time

from common import heading

if __name__ == "__main__":
    heading("fluxobs reproduce (targets 60 s, quick 15 s; --deep: long studies)")
    for options in ([], ["--quick"], ["--deep"]):
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            command = [sys.executable, "-m", "fluxobs", "reproduce", "--out", folder, *options]
            subprocess.run(command, check=True, capture_output=True)
            print(f"{' '.join(options) or 'full':10s} {time.perf_counter() - start:6.1f} s")
