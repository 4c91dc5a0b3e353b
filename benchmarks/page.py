"""The page and a report in a browser: sizes and waiting times.

Needs `make page`, Chromium and playwright. The logs repeat the demo log with additional noise.
With --size, it prints only the sizes of the built files and needs no browser; with --size --write,
these go to docs/numbers/page_size.json.
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
from numbers_data import Numbers

import fluxobs
from fluxobs.machines.files import example_text
from fluxobs.page import built
from fluxobs.presentation.report import write_report

PATIENCE = 300_000
#: Sources of page and report, besides the modules of fluxobs.
SOURCES = ("web/*.*", "web/app/*", "web/runtime/*", "src/fluxobs/**/*.py")


def log(rows: int) -> pl.DataFrame:
    """Repeat the demo log; the added current noise does not repeat."""
    demo = pl.read_csv(fluxobs.demo_log().path)
    frame = pl.concat([demo] * -(-rows // demo.height)).head(rows)
    noise = np.random.default_rng(1).normal(0.0, 0.02, (2, rows))
    return frame.with_columns(
        (pl.int_range(0, rows) * 2e-4).round(6).alias("t"),
        *(
            (pl.col(name) + pl.Series(values)).round(5)
            for name, values in zip(("i_alpha", "i_beta"), noise, strict=True)
        ),
    )


def open_page(browser, path: Path, ready: str):
    """Return (opened page, time until the page was ready [s])."""
    page = browser.new_page(viewport={"width": 1300, "height": 900})
    page.set_default_timeout(PATIENCE)
    started = time.perf_counter()
    page.goto(path.as_uri())
    page.wait_for_selector(ready)
    return page, time.perf_counter() - started


def longest_zoom(page) -> float:
    """Return the longest duration [ms] of ten zooms from all rows to few rows."""
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


def slider_time(page) -> float:
    """Return the median time [ms] from a slider move to the new picture, for five moves."""
    durations = []
    for value in (0.3, -0.3, 0.2, -0.2, 0.1):
        page.evaluate(
            """(v) => { const s = document.getElementById("slider-R_s"); s.value = v;
                       fluxobs.results.took = 0; s.dispatchEvent(new Event("input")); }""",
            value,
        )
        while not page.evaluate("() => fluxobs.results.took"):
            page.wait_for_timeout(20)
        durations.append(page.evaluate("() => fluxobs.results.took"))
    return float(np.median(durations))


def frame_rate(browser) -> float:
    """Return the frames per second of a stream; the simulator runs on the same processor."""
    process = subprocess.Popen(
        [sys.executable, "-m", "fluxobs", "live", "--demo", "--no-open", "--port", "0"],
        stdout=subprocess.PIPE,
        text=True,
    )
    address = re.search(r"http\S+", process.stdout.readline()).group()
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto(address)
    page.wait_for_timeout(6000)
    first_count = page.evaluate("() => fluxobs.live.frames")
    page.wait_for_timeout(5000)
    rate = (page.evaluate("() => fluxobs.live.frames") - first_count) / 5
    page.close()
    process.terminate()
    process.wait()
    return rate


def size(name: str) -> float:
    """Return the size of a built file [kB]."""
    return len(built(name).encode("utf-8")) / 1e3


def sizes() -> None:
    """Print the sizes of the page and of the report without data."""
    with Numbers("page_size", SOURCES) as numbers:
        rows = [("page", "400 kB", f"{size('page.html'):.0f} kB")]
        rows += [("report without data", "", f"{size('report.html'):.0f} kB")]
        for name, _, reached in rows:
            print(f"{name}: {reached}")
        numbers.table("sizes", ("quantity", "required", "reached"), rows)
        numbers.value("page", size("page.html"), "{:.0f} kB")
        numbers.value("report", size("report.html"), "{:.0f} kB")


def main() -> None:
    heading("page")
    sizes()
    if "--size" in sys.argv:
        return
    from playwright.sync_api import sync_playwright

    folder = Path(tempfile.mkdtemp())
    (folder / "page.html").write_text(built("page.html"), encoding="utf-8")
    with sync_playwright() as started:
        browser = started.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        for rows in (100_000, 1_000_000, 10_000_000):
            log(rows).write_csv(folder / "log.csv")
            page, _ = open_page(browser, folder / "page.html", "body[data-ready]")
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
            print(f"  zoom {longest_zoom(page):.0f} ms at most")
            if rows == 100_000:
                page.wait_for_selector("body[data-done]")
                print(f"  slider to new picture {slider_time(page):.0f} ms")
            page.close()
        log(2_000_000).write_parquet(folder / "log.parquet")
        result = fluxobs.estimate(folder / "log.parquet", "servo-400w", unknowns="drift")
        write_report(result, folder / "report.html")
        page, waited = open_page(browser, folder / "report.html", "body[data-done]")
        size = (folder / "report.html").stat().st_size / 1e6
        print(f"report of 2 million rows: {size:.1f} MB, first picture after {waited:.1f} s")
        print(f"  zoom {longest_zoom(page):.0f} ms at most")
        page.close()
        print(f"strip chart of fluxobs live --demo: {frame_rate(browser):.0f} frames per second")
        browser.close()
    shutil.rmtree(folder)


if __name__ == "__main__":
    main()
