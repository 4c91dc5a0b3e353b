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

#: Machine that --demo simulates.
DEMO_MACHINE = "servo-400w"
#: Longest wait for a browser [s] if the stream is recorded. Without a recording, a patient stream
#: waits without limit.
UNWATCHED = 10.0


@reads_logs("start", "stop", "join", "align", "record", "fit_truth")
def live(
    layout: dict[str, Any],
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="Serial port (/dev/ttyACM0, COM3), udp:PORT (from this computer; "
            "udp:0.0.0.0:PORT: from others too), socket://HOST:PORT, a growing file, or - for "
            "standard input. The source sends lines of CSV, or frames from telemetry.c of an "
            "exported observer.",
        ),
    ] = "",
    machine: Annotated[
        Path | None,
        typer.Option(
            help="Machine file (TOML: kind, R_s, … in SI units), or a name from `fluxobs machines`."
        ),
    ] = None,
    text: Annotated[
        bool,
        typer.Option("--text", help="Show the estimates in the terminal instead of the browser."),
    ] = False,
    demo: Annotated[
        bool,
        typer.Option(
            "--demo", help="Simulate a servo motor in real time instead of reading SOURCE."
        ),
    ] = False,
    save: Annotated[
        Path | None,
        typer.Option(help="File in which the rows are recorded for `fluxobs estimate`, .csv."),
    ] = None,
    baud: Annotated[int, typer.Option(help="Bits per second of a serial port.")] = 115200,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="TCP port of the page; 0: any free port.")
    ] = 8765,
    no_open: Annotated[
        bool, typer.Option("--no-open", help="Do not open the browser; only print the address.")
    ] = False,
    memory: Annotated[
        float | None, typer.Option(help="Memory of the least squares in seconds.")
    ] = None,
    unknowns: Annotated[
        str,
        typer.Option(
            help="Unknowns, as for `estimate`; auto (default): all unknowns that the "
            "observer can estimate."
        ),
    ] = "auto",
    prior: PriorOption = None,
    force: ForceOption = False,
) -> None:
    """Estimate from a stream while it arrives.

    Opens a browser page that plots the last seconds; no data leave this computer. With --text,
    shows the estimates in the terminal. Ctrl-C ends the command.

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
        raise UsageError("give --demo or a SOURCE: a serial port, udp:PORT, a file, or -")
    if machine is None and not demo:
        raise UsageError("--machine is missing: a machine file, or a name from `fluxobs machines`")
    if save is not None:
        check_new(save, (".csv",), force, "--save")
        refuse_input_as_output(save, Path(source), machine)
    motor = as_machine(machine or DEMO_MACHINE)
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
        watch = Watch(motor, Path(folder) / "stream", **settings, **layout)
        if recorder is not None:
            watch.record(stack.enter_context(recorder).add)
            stack.callback(_save_unread, recorder.path, watch)
        ctrl_c = stack.enter_context(_CtrlC())
        try:
            if text:
                _show_in_terminal(stream, watch, ctrl_c)
            else:
                facts = {"machine": machine_text(motor, [], {}), "options": layout, **settings}
                recorded = watch if save else None
                _show_in_browser(stream, recorded, port, not no_open, facts, ctrl_c)
        except show.Stopped:
            pass
        except FluxobsError as error:
            problem = error
    if recorder is not None and recorder.written:
        _report_recording(recorder.path, watch, str(machine or DEMO_MACHINE))
    if problem is not None:
        raise problem


def _save_unread(save: Path, watch: Watch) -> None:
    """Save the bytes in which no rows were found when the stream ends."""
    from ...live.recorder import save_raw

    if watch.unread:
        raw = save_raw(save, watch.unread)
        show.say(f"Written: {raw}, unchanged: the data contain no rows")


def _report_recording(save: Path, watch: Watch, machine: str) -> None:
    show.say(f"Written: {save}")
    command = ["fluxobs", "estimate", str(save), "--machine", machine]
    if watch.log is not None and watch.log.layout.lag:
        command += ["--lag", f"{watch.log.layout.lag:g}"]
    if watch.log is not None and watch.status.lost:  # lost rows hide the rate
        command += ["--sample-time", f"{watch.log.sample_time:g}"]
    show.say(f"To estimate the whole recording: {shlex.join(command)}")


class _CtrlC:
    """Handler of Ctrl-C: ends the stream after the current rows are estimated and sent.

    A second Ctrl-C ends the stream at once.
    """

    def __init__(self) -> None:
        self.pressed = self._waiting = False

    def __enter__(self) -> Self:
        self._before = signal.signal(signal.SIGINT, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        signal.signal(signal.SIGINT, self._before)

    def _on_signal(self, number: int, frame: object) -> None:
        if self._waiting or self.pressed:
            raise show.Stopped
        self.pressed = True

    def chunks(self, stream: Source) -> Iterator[tuple[bytes, bool]]:
        """Yield (data, last) of a stream; the last data are empty."""
        incoming = stream.chunks()
        try:
            while not self.pressed:
                self._waiting = True
                try:
                    data = next(incoming, None)
                finally:
                    self._waiting = False
                if data is None:
                    break
                yield data, False
        except (FluxobsError, SystemExit):  # SystemExit: Ctrl-C or SIGTERM
            self.pressed = True
            yield b"", True
            raise
        yield b"", True


def _show_in_terminal(stream: Source, watch: Watch, ctrl_c: _CtrlC) -> None:
    from ...live.terminal import Terminal

    with Terminal(watch, stream) as terminal:
        try:
            for data, last in ctrl_c.chunks(stream):
                for rows in watch.feed(data, last):
                    terminal.add(rows)
                if not last:
                    terminal.draw()
        finally:
            terminal.draw(force=True)


def _show_in_browser(
    stream: Source,
    watch: Watch | None,
    port: int,
    open_browser: bool,
    facts: Mapping[str, Any],
    ctrl_c: _CtrlC,
) -> None:
    from ...live.serve import Server

    server = Server(port, {"name": stream.name, **facts}, stream.patient)
    opened = open_browser and webbrowser.open(server.url)
    show.say(f"{'Opened' if opened else 'Open'}: {server.url} Press Ctrl-C to end.")
    since = time.monotonic()
    while stream.patient and not server.watched.wait(0.1) and not ctrl_c.pressed:
        if watch is not None and time.monotonic() - since > UNWATCHED:
            break
    warned = False
    try:
        for data, last in ctrl_c.chunks(stream):
            if stream.ignored and not warned:
                warned = True
                typer.echo("Only datagrams of the first sender are read.")
            if data:
                server.send(data)
            if watch is not None:
                list(watch.feed(data, last))
    finally:
        server.end(now=ctrl_c.pressed)
