"""The page and a report in a browser: sizes, and the times that a reader waits.

Needs `make page`, Chromium and playwright. Logs are the demo log, repeated with noise of its own.
"""

import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl
from common import heading
from playwright.sync_api import sync_playwright

import fluxobs
from fluxobs.estimation.report import write_report
from fluxobs.machines.files import example_text
from fluxobs.page import built

PATIENCE = 300_000


def log(rows: int) -> pl.DataFrame:
    """The demo log over and over, with noise of the current that does not repeat."""
    demo = pl.read_csv(fluxobs.demo_log().path)
    frame = pl.concat([demo] * -(-rows // demo.height)).head(rows)
    noise = np.random.default_rng(1).normal(0.0, 0.02, (2, rows))
    return frame.with_columns(
        (pl.int_range(0, rows) * 2e-4).round(6).alias("t"),
        *(
            (pl.col(n) + pl.Series(one)).round(5)
            for n, one in zip(("i_alpha", "i_beta"), noise, strict=True)
        ),
    )


def opened(browser, path: Path, ready: str):
    """A page, and how long it took until it was ready [s]."""
    page = browser.new_page(viewport={"width": 1300, "height": 900})
    page.set_default_timeout(PATIENCE)
    began = time.perf_counter()
    page.goto(path.as_uri())
    page.wait_for_selector(ready)
    return page, time.perf_counter() - began


def zooms(page) -> float:
    """Longest of ten zooms, from all to some rows [ms]."""
    return page.evaluate(
        """() => {
            const p = fluxobs.results.panels, [a, b] = p.full;
            let most = 0;
            for (let k = 0; k < 10; k++) {
                const half = (b - a) / 2 ** (2 * k + 1), middle = a + 0.4 * (b - a);
                const began = performance.now();
                p.zoom(middle - half, middle + half);
                most = Math.max(most, performance.now() - began);
            }
            p.zoom(a, b);
            return most;
        }"""
    )


def slider(page) -> float:
    """Median of five moves of a slider, to the new picture [ms]."""
    took = []
    for value in (0.3, -0.3, 0.2, -0.2, 0.1):
        page.evaluate(
            """(v) => { const s = document.getElementById("slider-R_s"); s.value = v;
                       fluxobs.results.took = 0; s.dispatchEvent(new Event("input")); }""",
            value,
        )
        while not page.evaluate("() => fluxobs.results.took"):
            page.wait_for_timeout(20)
        took.append(page.evaluate("() => fluxobs.results.took"))
    return float(np.median(took))


def frames(browser) -> float:
    """Pictures of a stream in a second; the simulator runs on the same processor."""
    running = subprocess.Popen(
        [sys.executable, "-m", "fluxobs", "live", "--demo", "--no-open", "--port", "0"],
        stdout=subprocess.PIPE,
        text=True,
    )
    address = re.search(r"http\S+", running.stdout.readline()).group()
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto(address)
    page.wait_for_timeout(6000)
    before = page.evaluate("() => fluxobs.live.frames")
    page.wait_for_timeout(5000)
    found = (page.evaluate("() => fluxobs.live.frames") - before) / 5
    page.close()
    running.terminate()
    running.wait()
    return found


def main() -> None:
    heading("page")
    folder = Path(tempfile.mkdtemp())
    (folder / "page.html").write_text(built("page.html"), encoding="utf-8")
    print(f"page: {(folder / 'page.html').stat().st_size / 1e3:.0f} kB")
    with sync_playwright() as started:
        browser = started.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        for rows in (100_000, 1_000_000, 10_000_000):
            log(rows).write_csv(folder / "log.csv")
            page, _ = opened(browser, folder / "page.html", "body[data-ready]")
            page.evaluate(
                """(m) => { document.getElementById("machine").value = m;
                           document.getElementById("unknowns").value = "drift"; }""",
                example_text("servo-400w"),
            )
            page.set_input_files("#files", folder / "log.csv")
            page.wait_for_selector("body[data-seconds]")
            waited = float(page.evaluate("() => document.body.dataset.seconds"))
            size = (folder / "log.csv").stat().st_size / 1e6
            print(f"CSV of {rows} rows, {size:.0f} MB: estimated and drawn after {waited:.1f} s")
            print(f"  zoom {zooms(page):.0f} ms at most")
            if rows == 100_000:
                page.wait_for_selector("body[data-done]")
                print(f"  slider to new picture {slider(page):.0f} ms")
            page.close()
        log(2_000_000).write_parquet(folder / "log.parquet")
        result = fluxobs.estimate(folder / "log.parquet", "servo-400w", unknowns="drift")
        write_report(result, folder / "report.html")
        page, waited = opened(browser, folder / "report.html", "body[data-done]")
        size = (folder / "report.html").stat().st_size / 1e6
        print(f"report of 2 million rows: {size:.1f} MB, first picture after {waited:.1f} s")
        print(f"  zoom {zooms(page):.0f} ms at most")
        page.close()
        print(f"strip chart of fluxobs live --demo: {frames(browser):.0f} frames a second")
        browser.close()
    shutil.rmtree(folder)


if __name__ == "__main__":
    main()
