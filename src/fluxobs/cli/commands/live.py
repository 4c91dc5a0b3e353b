"""`fluxobs live`."""

from __future__ import annotations

import shlex
import signal
import tempfile
import time
import webbrowser
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import typer

from ...errors import FluxobsError
from .. import show
from ..options import ForceOption, PriorOption, numbers, reads_logs, refuse_input_as_output

if TYPE_CHECKING:
    from ...live import Watch
    from ...live.sources import Source

#: The machine of the demo.
DEMO_MACHINE = "servo-400w"
#: Seconds for which a stream that is recorded, and can wait, waits for a browser.
UNWATCHED = 10.0


@reads_logs("start", "stop", "join", "align", "record", "fit_truth")
def live(
    layout: dict[str, Any],
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="A serial port (/dev/ttyACM0, COM3), udp:PORT (from this computer; "
            "udp:0.0.0.0:PORT: from others too), socket://HOST:PORT, a file that is being "
            "written, or - for standard input. It sends lines of CSV, or the frames of "
            "an exported observer's telemetry.c.",
        ),
    ] = "",
    machine: Annotated[
        Path | None,
        typer.Option(help="TOML with kind, R_s, … in SI; or a name from `fluxobs machines`."),
    ] = None,
    text: Annotated[
        bool, typer.Option("--text", help="Show it in the terminal, not in the browser.")
    ] = False,
    demo: Annotated[
        bool, typer.Option("--demo", help="Stream a simulated servo motor, in real time.")
    ] = False,
    save: Annotated[
        Path | None,
        typer.Option(help="Record the rows as they come, .csv, for `fluxobs estimate`."),
    ] = None,
    baud: Annotated[int, typer.Option(help="Bits a second of a serial port.")] = 115200,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Of the page; 0: any that is free.")
    ] = 8765,
    no_open: Annotated[
        bool, typer.Option("--no-open", help="Do not open the browser, only say the address.")
    ] = False,
    memory: Annotated[
        float | None, typer.Option(help="Seconds; memory of the least squares.")
    ] = None,
    unknowns: Annotated[
        str,
        typer.Option(help="As for `estimate`; auto (default): all that the observer finds."),
    ] = "auto",
    prior: PriorOption = None,
    force: ForceOption = False,
) -> None:
    """Estimate a stream while it comes: position, speed, drift and parameters as they are now.

    It opens a page in the browser, with strips of the last seconds; nothing leaves this computer.
    With --text it shows the same in the terminal. Ctrl-C ends it.

    Example: fluxobs live /dev/ttyACM0 --machine motor.toml --save run.csv
    """
    from ...core.output import check_new
    from ...errors import UsageError
    from ...live import Watch
    from ...live.recorder import Recorder
    from ...live.sources import Demo, open_source
    from ...machines.file_text import machine_text
    from ...machines.files import as_machine

    if demo == bool(source):
        raise UsageError("give a SOURCE or --demo: a serial port, udp:PORT, a file, or -")
    if machine is None and not demo:
        raise UsageError("--machine is missing: a machine file, or a name from `fluxobs machines`")
    if save is not None:
        check_new(save, (".csv",), force, "--save")
        refuse_input_as_output(save, Path(source), machine)
    given = as_machine(machine or DEMO_MACHINE)
    stream = Demo() if demo else open_source(source, baud)
    settings: dict[str, Any] = {
        "unknowns": unknowns,
        "memory": memory,
        "priors": numbers("prior", prior),
    }
    problem: FluxobsError | None = None
    recorder = None if save is None else Recorder(save, force)
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="fluxobs-"))
        watch = Watch(given, Path(folder) / "stream", **settings, **layout)
        if recorder is not None:
            watch.record(stack.enter_context(recorder).add)
            stack.callback(_keep_unread, recorder.path, watch)
        stopping = stack.enter_context(_Stopping())
        try:
            if text:
                _in_terminal(stream, watch, stopping)
            else:
                facts = {"machine": machine_text(given, [], {}), "options": layout, **settings}
                taken = watch if save else None
                _in_browser(stream, taken, port, not no_open, facts, stopping)
        except show.Stopped:
            pass
        except FluxobsError as error:
            problem = error
    if recorder is not None and recorder.written:
        _say_written(recorder.path, watch, str(machine or DEMO_MACHINE))
    if problem is not None:
        raise problem


def _keep_unread(save: Path, watch: Watch) -> None:
    """Write what came before there were rows, whatever ends the stream."""
    from ...live.recorder import save_raw

    if watch.unread:
        raw = save_raw(save, watch.unread)
        show.say(f"Written: {raw}, as it came: no rows were found in it")


def _say_written(save: Path, watch: Watch, machine: str) -> None:
    show.say(f"Written: {save}")
    words = ["fluxobs", "estimate", str(save), "--machine", machine]
    if watch.log is not None and watch.log.layout.lag:
        words += ["--lag", f"{watch.log.layout.lag:g}"]
    if watch.log is not None and watch.status.lost:  # the rate is known from the first rows
        words += ["--sample-time", f"{watch.log.sample_time:g}"]
    show.say(f"All of it at once: {shlex.join(words)}")


class _Stopping:
    """Ctrl-C ends a stream; while rows are estimated or sent, it waits until they are. A second
    one does not wait."""

    def __init__(self) -> None:
        self.asked = self._waiting = False

    def __enter__(self) -> Self:
        self._before = signal.signal(signal.SIGINT, self._stop)
        return self

    def __exit__(self, *_: object) -> None:
        signal.signal(signal.SIGINT, self._before)

    def _stop(self, number: int, frame: object) -> None:
        if self._waiting or self.asked:
            raise show.Stopped
        self.asked = True

    def pieces(self, stream: Source) -> Iterator[tuple[bytes, bool]]:
        """What a stream brings, and whether that was the last, also of one that is ended."""
        chunks = stream.chunks()
        try:
            while not self.asked:
                self._waiting = True
                try:
                    data = next(chunks, None)
                finally:
                    self._waiting = False
                if data is None:
                    break
                yield data, False
        except (FluxobsError, SystemExit):  # also by Ctrl-C, or a signal to end
            self.asked = True
            yield b"", True
            raise
        yield b"", True


def _in_terminal(stream: Source, watch: Watch, stopping: _Stopping) -> None:
    from ...live.terminal import Terminal

    with Terminal(watch, stream) as terminal:
        try:
            for data, last in stopping.pieces(stream):
                for rows in watch.feed(data, last):
                    terminal.add(rows)
                if not last:
                    terminal.draw()
        finally:
            terminal.draw(force=True)


def _in_browser(
    stream: Source,
    watch: Watch | None,
    port: int,
    opens: bool,
    facts: Mapping[str, Any],
    stopping: _Stopping,
) -> None:
    from ...live.serve import Server

    server = Server(port, {"name": stream.name, **facts}, stream.patient)
    opened = opens and webbrowser.open(server.url)
    show.say(f"{'Opened' if opened else 'Open'}: {server.url} Ctrl-C ends it.")
    since = time.monotonic()
    while stream.patient and not server.watched.wait(0.1) and not stopping.asked:
        if watch is not None and time.monotonic() - since > UNWATCHED:
            break
    said = False
    try:
        for data, last in stopping.pieces(stream):
            if stream.ignored and not said:
                said = True
                typer.echo("Datagrams of other senders are left out: the first one is taken.")
            if data:
                server.send(data)
            if watch is not None:
                list(watch.feed(data, last))
    finally:
        server.end(now=stopping.asked)
