"""Runs of the whole chain, of one skin or of several on one hub."""

import secrets
import shlex
import time
from collections.abc import Callable, Collection, Generator, Sequence
from contextlib import ExitStack, closing
from functools import partial
from math import inf
from pathlib import Path
from typing import Any, Final

import msgspec

from calibration.windows import tare_s
from canskin.errors import InputError, RunError
from canskin.fabric import Fabric
from canskin.keys import UNIX
from canskin.peers import Peer, Roll
from classifier.newest_sums import averaged_cycles
from demo.options import DemoOptions
from demo.picture import save_picture
from demo.processor_time import ratios
from demo.rate import LEAST_PART, LEAST_RUN_S, RateJudge, at_rate
from demo.report import WORDS, Report
from demo.score import Score
from demo.supervisor import Supervisor
from shell.service import PAGE_TOKEN, StopSignal, Talk, listen, request_real_time, say, talks
from shell.terminal import ProgressBar, arguments, progress
from skin.layout import Layout, layout_text
from skin.psnr import adds_noise
from skin.sources import DEFAULT_OBJECTS, known_objects

DEFAULT_PORT: Final = 8765
#: Time without touch where there are offsets, beside that in which the zero is measured.
REST_S: Final = 1.5
#: A first run compiles the solver and trains the classifier.
READY_PATIENCE_S: Final = 600.0
FIRST_CYCLE_PATIENCE_S: Final = 20.0
TURN_S: Final = 0.1
#: A start that takes longer is explained.
SLOW_START_S: Final = 8.0


#: What a run does until its report: in each turn it tells the time since its first cycle, seconds, and its state.
Turns = Generator[tuple[float, str], None, Report]


class Run:
    """Starts the services of a skin, watches them, and reports; the options are checked before.

    Parameters
    ----------
    folder : pathlib.Path
        Of the logs and of the buses' sockets.
    is_alone : bool
        No other skin is on the hub. Where others are, the page is of all of them, and waits for their gateways.
    """

    def __init__(self, layout: Layout, options: DemoOptions, folder: Path, *, is_alone: bool = True) -> None:
        folder.mkdir(mode=0o700, exist_ok=True)
        self.name = layout.name
        self._is_alone = is_alone
        self._layout = layout
        self._options = options
        self.score = Score(layout)
        self._folder = folder
        self._page_token = secrets.token_urlsafe()
        self._supervisor = Supervisor(folder, {PAGE_TOKEN: self._page_token})
        self._there = Roll()
        #: Services were started before, at another rate.
        self._has_begun = False
        self._fabric: Fabric | None = None
        self._port = _page_port(options.port) if options.view else None
        self._path = str(options.layout[0]) if options.layout else "default"
        self._lowest_hz = layout.sync.rate_hz * LEAST_PART
        self._judge = rate_judge(self._layout, options, self._lowest_hz)
        if options.sync_rate is not None:
            self._take_rate(options.sync_rate)

    def turns(self, endpoint: str, fabric: Fabric, stop: StopSignal, tell: Callable[[str], None]) -> Turns:
        """Run the chain until the end of its time or `stop`, and return the figures; `tell` prints a line.

        Raises
        ------
        KeyboardInterrupt
            If `stop` came before the first cycle; there are no figures then.
        """
        if stop.is_set():
            raise KeyboardInterrupt
        with ExitStack() as last:
            last.callback(self._supervisor.stop)
            self._fabric = fabric
            self._listen(fabric)
            while not (yield from self._try_rate(stop, endpoint, tell)):
                self._supervisor.stop()
                self._supervisor.children.clear()  # services that were ended are not missed
                self._take_rate(self._layout.sync.rate_hz / 2)
            if stop.is_set() and not self._has_started():
                self._supervisor.stop_at_once()
                raise KeyboardInterrupt
            # In this order every sent frame is counted as received or lost: nodes send at SYNC, or by themselves.
            for name in ("gateway", "nodes") if self._layout.sends.in_cycles else ("nodes", "gateway"):
                self._supervisor.stop(name)
                time.sleep(TURN_S)  # wait for the last frames and counters
        return self.score.report()

    def _try_rate(
        self, stop: StopSignal, endpoint: str, tell: Callable[[str], None]
    ) -> Generator[tuple[float, str], None, bool]:
        """Run the chain to the end of its time; tell at once if the machine does not keep the rate."""
        self._start_services(endpoint)
        yield from self._await_services(stop)
        if stop.is_set():
            return True
        if not self.score.scheduling:
            request_real_time("demo", self._obtained)  # all messages go through this process
        # Messages of services that were ended may have come late: the next cycles are those of a new gateway.
        self.score = self._new_score()
        tare = "at-start" if self._options.has_zero_errors(self._layout) else "never"
        self._supervisor.start("gateway", "gateway", *self._common(endpoint), "--tare", tare)
        if not self._is_alone:  # the page of many skins asks the gateways, for which it waits 30 s at most
            self._start_viewer(["--connect", endpoint])
        return (yield from self._follow(stop, endpoint, tell))

    def _take_rate(self, rate_hz: float) -> None:
        """Go on with a layout of another rate, and with services that are not there yet."""
        self._layout = at_rate(self._layout, rate_hz)
        path = self._folder / "layout.toml"
        path.write_text(layout_text(self._layout))
        self._path, self._judge = str(path), rate_judge(self._layout, self._options, self._lowest_hz)
        self._there, self.score = Roll(), self._new_score()

    def _new_score(self) -> Score:
        """Return a score of the present layout that has taken no message."""
        return type(self.score)(self._layout, scheduling=self.score.scheduling)

    def _obtained(self, scheduling: str) -> None:
        """Tell page and summary the scheduling of this process."""
        self.score.scheduling = scheduling
        if self._fabric is not None:
            self._fabric.tell_scheduling(scheduling)

    def save_picture(self, report: Report) -> Report | None:
        """Save the picture if there was contact; return the report with its path, None if the file was not written."""
        if self.score.snapshot is None:
            return report
        path, taxels = self._options.picture, self._layout.taxels
        try:
            save_picture(self.score.snapshot, taxels, path, noisy=bool(report.sensor_adds_noise))
        except OSError as error:  # print the figures without the picture
            say("demo", f"{path}: cannot write the picture: {error.strerror or error}")
            return None
        return msgspec.structs.replace(report, picture=str(path.resolve()))

    @property
    def _of_layout(self) -> list[str]:
        return ["--layout", self._path]

    def _common(self, endpoint: str) -> list[str]:
        return [*self._of_layout, "--connect", endpoint]

    def _listen(self, fabric: Fabric) -> None:
        for topic, take in self.score.topics:
            fabric.subscribe(topic, partial(self._take, take))
        fabric.watch_peers(self._note)

    def _take(self, take: str, message: Any) -> None:
        """Let the score of the present rate, or of whoever times the chain, take a message."""
        getattr(self.score, take)(message)

    def _note(self, peer: Peer, is_there: bool) -> None:
        if peer.skin == self._layout.name:
            self._there.note(peer.service, peer.key, is_there)

    def _start_services(self, endpoint: str) -> None:
        options, start, common = self._options, self._supervisor.start, self._common(endpoint)
        touch = options.touch
        rest = []
        if touch.input is None and options.has_zero_errors(self._layout):
            rest = ["--rest", str(REST_S + tare_s(self._layout.sync.round_s))]
        start("nodes", "nodes", *common, *arguments(touch), *rest, *["--firmware"] * options.firmware)
        solver = [] if options.solver is None else arguments(options.solver)
        start("reconstructor", "reconstruct", *common, *solver, restart=True)
        known = [*_known_objects(touch.names), "--stroke", touch.stroke]
        if options.model is not None:
            known = ["--model", str(options.model)]
        if options.classify:
            start("classifier", "classify", *common, *known, restart=True)
        if self._is_alone:
            self._start_viewer(common)

    def _start_viewer(self, shown: list[str]) -> None:
        if self._port is not None:
            self._supervisor.start("viewer", "view", *shown, "--port", str(self._port), restart=True)

    def _await_services(self, stop: StopSignal) -> Generator[tuple[float, str]]:
        """Wait until every service is on the fabric."""
        slow_s = inf if self._has_begun else time.monotonic() + SLOW_START_S
        self._has_begun = True
        patience_s = time.monotonic() + READY_PATIENCE_S
        while (missing := self._missing()) and not stop.is_set():
            self._supervisor.look(starting=True)
            yield 0.0, f"starting: waiting for {missing}"
            if time.monotonic() > slow_s:
                slow_s = inf
                why = "a first start compiles the solver"
                if "classifier" in missing and self._options.model is None:
                    why += ", and new objects train the classifier (not with --no-classify)"
                say("demo", f"waits for {missing}; {why}: minutes")
            if time.monotonic() > patience_s:
                raise RunError(f"{missing} did not become ready in {READY_PATIENCE_S:g} s")

    def _missing(self) -> str:
        """Name the services that the gateway waits for and that are not on the fabric."""
        wanted = ["classifier"] * self._options.classify + ["nodes", "reconstructor"]
        wanted += ["viewer"] * (self._port is not None and self._is_alone)
        return ", ".join(name for name in wanted if not self._there.holds(name))

    def _follow(
        self, stop: StopSignal, endpoint: str, tell: Callable[[str], None]
    ) -> Generator[tuple[float, str], None, bool]:
        """Show progress until the end of the run, or until the rate is not kept; tell whether it was."""
        if self._port is not None:
            tell(f"web page: http://127.0.0.1:{self._port}/?token={self._page_token}")
        pids = ", ".join(f"{child.name} {child.process.pid}" for child in self._supervisor.children.values())
        tell(f"processes{'' if self._is_alone else f' of {self.name}'}: {pids}")
        yield from self._await_first_cycle(stop)
        addresses = self._addresses(endpoint)
        start_s, before = time.monotonic(), self._supervisor.processor_times()
        is_kept = True
        while is_kept and (elapsed_s := time.monotonic() - start_s) < self._options.seconds and not stop.is_set():
            yield elapsed_s, self._line()
            for event in self._supervisor.look():
                tell(event)
            is_kept = self._judge.keeps(self.score.gateway, elapsed_s)
            while is_kept and self._judge.is_judged and addresses:
                tell(addresses.pop(0))
        self.score.cpu_ratio = ratios(before, self._supervisor.processor_times(), time.monotonic() - start_s)
        if not is_kept:
            self._say_slower()
        return is_kept

    def _addresses(self, endpoint: str) -> list[str]:
        """Return what programs beside the run need: told when the gateway answers, at the rate of all the run."""
        of = ["--connect", endpoint, *([] if self._is_alone else ["--skin", self.name])]
        watch = ["skin", "monitor", *of]  # skin doctor, skin list and others take it, too
        record = ["skin", "record", "run.mcap", *of]
        return [
            f"fabric: {endpoint}",
            f"to watch: {shlex.join(watch)}",
            f"to record: SKIN_BUS_DIR={self._folder} {shlex.join(record)}",
        ]

    def _say_slower(self) -> None:
        report, rate_hz = self.score.report(), self._layout.sync.rate_hz
        why = report.likely_cause or "other programs delay the chain"
        say(
            "demo",
            f"this machine does not keep {rate_hz:g} Hz, {report.cycles_complete} of {report.cycles} cycles were"
            f" complete: {why}. Starting again with {rate_hz / 2:g} Hz; --sync-rate {rate_hz:g} keeps the rate",
        )

    def _await_first_cycle(self, stop: StopSignal) -> Generator[tuple[float, str]]:
        """Wait for the first SYNC; longer while the gateway compiles."""
        patience_s, is_ready = time.monotonic() + READY_PATIENCE_S, False
        while not self._has_started() and not stop.is_set():
            self._supervisor.look()
            yield 0.0, "starting: waiting for gateway"
            if not is_ready and self.score.gateway is not None:
                patience_s, is_ready = time.monotonic() + FIRST_CYCLE_PATIENCE_S, True
            if time.monotonic() > patience_s:
                why = "no cycle came from the gateway" if is_ready else "gateway did not become ready"
                raise RunError(f"{why} in {FIRST_CYCLE_PATIENCE_S if is_ready else READY_PATIENCE_S:g} s")

    def _has_started(self) -> bool:
        """Tell whether SYNC has."""
        return self.score.gateway is not None and self.score.gateway.cycles > 0

    def _line(self) -> str:
        """Return the state of the run in one line."""
        gateway, score = self.score.gateway, self.score
        parts = [""]
        if gateway:
            newest = WORDS[self._layout.sending].newest
            parts = [newest.format(cycles=gateway.cycles, complete=gateway.cycles_complete)]
        if score.psnr_image_db:
            sensor_db = score.psnr_sensor_db[-1]
            noisy = adds_noise(sensor_db, self._layout.taxels.adc_bits)
            parts.append(f"image {score.psnr_image_db[-1]:.1f} dB" + f", one raw sample {sensor_db:.1f} dB" * noisy)
        parts.append(score.label_text())
        return " | ".join(parts)


def rate_judge(layout: Layout, options: DemoOptions, lowest_hz: float) -> RateJudge:
    """Return what judges the rate of a run; a rate that was given, or whose half is below `lowest_hz`, is kept.

    So is the rate of a model that knows means of cycles, and that of a run which is too short to judge.
    """
    is_given = options.sync_rate is not None or (options.model is not None and averaged_cycles(layout) > 1)
    is_kept = is_given or options.seconds < LEAST_RUN_S or not layout.sends.in_cycles
    return RateJudge(is_given=is_kept or layout.sync.rate_hz / 2 < lowest_hz)


def _known_objects(touching: Collection[str]) -> list[str]:
    """Return the classifier's option for its objects; none for the default objects."""
    known = known_objects(touching)
    return [] if known == DEFAULT_OBJECTS else ["--objects", ",".join(known)]


def execute(runs: Sequence[Run], options: DemoOptions, folder: Path, stop: StopSignal) -> list[Report]:
    """Run the chains on one hub until the end of their time or `stop`, and return the figures of each.

    Raises
    ------
    KeyboardInterrupt
        If `stop` came before the first cycle of a run.
    """
    endpoint, reports = options.listen or f"{UNIX}/{folder / 'hub'}", dict[Run, Report]()
    with ExitStack() as closes, progress("", options.seconds) as bar:
        turns, states = dict[Run, Turns](), dict[Run, tuple[float, str]]()
        for each in runs:
            fabric = closes.enter_context(closing(Fabric(each.name, "demo", endpoint, hub=not turns)))
            turns[each] = closes.enter_context(closing(each.turns(endpoint, fabric, stop, partial(_tell, bar))))
        while len(reports) < len(runs):
            for run in [each for each in runs if each not in reports]:
                try:
                    states[run] = next(turns[run])
                except StopIteration as end:
                    reports[run] = end.value
            words = [f"{each.name}: " * (len(runs) > 1) + state for each, (_, state) in states.items()]
            bar.update(min((done_s for done_s, _ in states.values()), default=0.0), "  ".join(words))
            stop.wait(TURN_S)
    return [reports[each] for each in runs]


def _tell(bar: ProgressBar, line: str) -> None:
    if talks(Talk.NORMAL):
        bar.print(line)


def _page_port(wanted: int | None) -> int:
    """Return the port of the page: the given port, else the default or a free port; 0 means a free port."""
    if wanted is not None:
        return wanted or _free_port()
    try:
        listen("127.0.0.1", DEFAULT_PORT).close()
    except InputError:
        return _free_port()
    return DEFAULT_PORT


def _free_port() -> int:
    with listen("127.0.0.1", 0) as free:
        return int(free.getsockname()[1])
