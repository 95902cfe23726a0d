"""The service between two ends of a fabric, and the verb as a process."""

import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError
from canskin.fabric import Fabric
from canskin.messages import CONTACTS, IMAGE, MEASUREMENT, Contacts, Image, Measurement
from reconstructor.imaging import make_imager
from reconstructor.options import SolverOptions
from reconstructor.service import ReconstructorService
from shell.service import StopSignal
from skin.layout import load_layout
from skin.measured_sums import decode_stepped
from tests.layouts import STEPPED_SKIN
from tests.messages import Published, stepped_measurement
from tests.processes import PATIENCE_S
from tests.reconstructor.helpers import LAYOUT, Scene, measurement, pixels, psnr_db


@pytest.fixture
def hub(endpoint: str) -> Iterator[Fabric]:
    fabric = Fabric(LAYOUT.name, "gateway", endpoint, hub=True)
    yield fabric
    fabric.close()


@pytest.fixture
def service(hub: Fabric, endpoint: str) -> Iterator[ReconstructorService]:
    fabric = Fabric(LAYOUT.name, "reconstructor", endpoint)
    imager = make_imager(LAYOUT)
    imager.warm_up()
    made = ReconstructorService(LAYOUT, imager, fabric)
    stop = StopSignal()
    thread = threading.Thread(target=made.run, args=(stop,))
    thread.start()
    yield made
    stop.set()
    thread.join()
    fabric.close()


class Exchange:
    """Sends measurements and waits for their images."""

    def __init__(self, hub: Fabric) -> None:
        self._hub = hub
        self._images: queue.Queue[Image] = queue.Queue()
        hub.subscribe(IMAGE, self._images.put)

    def image_of(self, sent: Measurement) -> Image:
        """Send until the image of that cycle comes; the first subscriptions take their time."""
        for _ in range(round(PATIENCE_S / 0.1)):
            self._hub.publish(MEASUREMENT, sent)
            try:
                while True:
                    image = self._images.get(timeout=0.1)
                    if image.cycle == sent.cycle:
                        return image
            except queue.Empty:
                continue
        pytest.fail("no image came")


@pytest.mark.parametrize(("sums", "scheduling"), [(64, "ordinary"), (128, "realtime"), (1024, "realtime")])
def test_images_of_fewer_sums_than_blocks_let_other_services_go_first(
    hub: Fabric, monkeypatch: pytest.MonkeyPatch, sums: int, scheduling: str
) -> None:
    monkeypatch.setattr("reconstructor.service.request_real_time", lambda _service, tell: tell("realtime"))
    monkeypatch.setattr("reconstructor.service.yield_processor", lambda: "ordinary")
    layout = msgspec.structs.replace(LAYOUT, measurement=msgspec.structs.replace(LAYOUT.measurement, sums=sums))
    told: list[str] = []
    ReconstructorService(layout, make_imager(layout), hub).schedule(told.append)
    assert told == [scheduling]


def test_image_of_a_measurement(hub: Fabric, service: ReconstructorService, golf: Scene) -> None:
    image = Exchange(hub).image_of(measurement(7, golf.sensor[30]))
    assert (image.sync_counter, image.sampled_mono_ns, image.valid_sums) == (7, 7000, 1024)
    assert image.valid == bytes([1]) * 128
    assert image.solve_s > 0
    assert image.published_mono_ns <= time.monotonic_ns()
    pixels = np.frombuffer(image.pixels, "<f4").reshape(64, 64)
    assert np.mean((pixels - golf.true[30]) ** 2) < np.mean((golf.sensor[30] - golf.true[30]) ** 2)
    assert service.images >= 1


def test_missing_blocks_and_an_empty_cycle(hub: Fabric, service: ReconstructorService, golf: Scene) -> None:
    exchange = Exchange(hub)
    some = np.arange(128) % 4 > 0
    image = exchange.image_of(measurement(1, golf.sensor[30], some))
    assert image.valid_sums == 768
    assert np.array_equal(np.frombuffer(image.valid, np.uint8) != 0, some)
    usable = np.ones(1024, np.uint8)
    usable[0] = 0
    image = exchange.image_of(msgspec.structs.replace(measurement(3, golf.sensor[30]), usable=usable.tobytes()))
    assert image.valid == b"\0" + bytes([1]) * 127
    empty = exchange.image_of(measurement(4, golf.sensor[30], np.zeros(128)))
    assert empty.valid_sums == 0
    assert not np.frombuffer(empty.pixels, "<f4").any()


def test_contacts_come_with_every_image_and_a_blind_image_says_nothing_of_them(
    hub: Fabric, service: ReconstructorService, golf: Scene
) -> None:
    found: queue.Queue[Contacts] = queue.Queue()
    hub.subscribe(CONTACTS, found.put)
    exchange = Exchange(hub)

    def contacts_of(cycle: int, valid: np.ndarray) -> Contacts:
        exchange.image_of(measurement(cycle, golf.true[30], valid))
        return next(each for each in iter(lambda: found.get(timeout=240), None) if each.cycle == cycle)

    whole, partly, blind = (
        contacts_of(1, np.ones(128)), contacts_of(2, np.arange(128) % 16 > 0), contacts_of(3, np.zeros(128))
    )  # fmt: skip
    contact, later = whole.contacts[0], partly.contacts[0]
    assert contact.force_n == pytest.approx(golf.true[30].sum(), rel=0.1)
    assert contact.identity == later.identity
    assert contact.onset_mono_ns == later.onset_mono_ns == 1000
    assert contact.invalid_taxels == 0
    # One block in sixteen is not valid, and blocks are scattered over the skin.
    assert later.invalid_taxels == pytest.approx(later.taxels / 16, rel=0.7)
    assert [whole.blind, partly.blind, blind.blind] == [False, False, True]
    assert not blind.contacts
    assert not blind.ended


def test_doubtful_taxels_come_with_the_image_and_make_their_contact_doubtful(
    hub: Fabric, service: ReconstructorService, golf: Scene
) -> None:
    found: queue.Queue[Contacts] = queue.Queue()
    hub.subscribe(CONTACTS, found.put)
    doubtful = np.packbits(golf.true[30] > 0).tobytes()
    image = Exchange(hub).image_of(msgspec.structs.replace(measurement(5, golf.true[30]), doubtful=doubtful))
    assert image.doubtful == doubtful
    contacts = next(each for each in iter(lambda: found.get(timeout=240), None) if each.cycle == 5)
    assert [each.doubtful_since_mono_ns for each in contacts.contacts] == [5000]


def test_what_does_not_fit_is_refused_and_told_once(
    hub: Fabric, service: ReconstructorService, golf: Scene, caplog: pytest.LogCaptureFixture
) -> None:
    exchange = Exchange(hub)
    good = measurement(1, golf.sensor[30])
    exchange.image_of(good)
    bad = [
        msgspec.structs.replace(good, cycle=2, fingerprint="0" * 16),
        msgspec.structs.replace(good, cycle=3, fingerprint="\x1b[2J" * 1000),
        msgspec.structs.replace(good, cycle=4, sums=good.sums[:-1]),
        msgspec.structs.replace(good, cycle=5, valid=good.valid + b"\1"),
        msgspec.structs.replace(good, cycle=6, sums=b""),
    ]
    before = service.images
    for each in bad:
        service.take(each)
    assert service.images == before
    exchange.image_of(msgspec.structs.replace(good, cycle=9))
    said = caplog.text
    assert said.count("measurement refused") == 1
    assert "expected " + good.fingerprint in said


def test_extreme_counts_do_no_harm(service: ReconstructorService, golf: Scene) -> None:
    good = measurement(1, golf.sensor[30])
    for value in (-(2**31), 2**31 - 1):
        service.take(msgspec.structs.replace(good, sums=np.full(1024, value, "<i4").tobytes()))
    assert service.images == 2


def test_stepped_sums_give_an_image_of_what_is_known(golf: Scene) -> None:
    exchange, layout = Published(), STEPPED_SKIN
    service = ReconstructorService(layout, make_imager(layout), exchange)
    known = np.ones((128, 32), np.bool_)
    known[40], known[50, 7] = False, False
    service.take(stepped_measurement(golf.true[30], known, layout=layout, cycle=7, sync_counter=3, sampled_mono_ns=5))
    (image,) = exchange.of(Image)
    assert (image.cycle, image.sync_counter, image.sampled_mono_ns, image.valid_sums) == (7, 3, 5, 4096 - 33)
    assert np.flatnonzero(np.frombuffer(image.valid, np.uint8) == 0).tolist() == [40, 50]
    assert np.sqrt(np.mean((pixels(image) - golf.true[30]) ** 2)) < 2e-4
    service.take(measurement(8, golf.sensor[30]))
    whole = stepped_measurement(golf.true[30], layout=layout)
    service.take(msgspec.structs.replace(whole, known=b"", states=b"", since_ns=b""))
    assert len(exchange.of(Image)) == 1


def test_of_stepped_measurements_only_the_newest_counts(golf: Scene) -> None:
    exchange, layout = Published(), STEPPED_SKIN
    ReconstructorService(layout, make_imager(layout), exchange)
    (mailbox,) = exchange.mailboxes
    for cycle in (9, 10):
        mailbox.put(stepped_measurement(golf.true[30], layout=layout, cycle=cycle))
    assert mailbox.get().cycle == 10


def test_unclipped_noise_has_no_bias_to_correct() -> None:
    with pytest.raises(InputError, match="--noise-n is for taxels that are clipped"):
        make_imager(load_layout(Path("analogue")), SolverOptions(noise_n=1e-3))


def test_stepped_sums_take_each_solver_without_a_memory_of_cycles(golf: Scene) -> None:
    true, layout = golf.true[30], STEPPED_SKIN
    sums = decode_stepped(stepped_measurement(true, layout=layout), layout.operator())
    half = np.arange(len(sums.known)) % 2 == 0
    for name in ("variation", "spun", "paper", "paper-contourlet"):
        imager = make_imager(layout, SolverOptions(solver=name))
        image, used = imager.solve(sums)
        assert used.all()
        assert psnr_db(image[None], true[None])[0] > 40, name
        image, used = imager.solve(sums._replace(counts=np.where(half, sums.counts, 0), known=half))
        assert image.any()
        np.testing.assert_array_equal(used, half)
    with pytest.raises(InputError, match="averages the sums of cycles, and steps have none"):
        make_imager(layout, SolverOptions(solver="live"))


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_verb_is_ready_and_ends_quietly(hub: Fabric, endpoint: str, golf: Scene, number: signal.Signals) -> None:
    verb = [sys.executable, "-m", "skin", "reconstruct", "--layout=default", "--connect", endpoint, "--iterations=5"]
    with subprocess.Popen(verb, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        line = process.stderr.readline()
        if line.startswith("kernels: "):
            line = process.stderr.readline()
        assert line == "reconstructor: 64 x 64 taxels, 5 iterations\n"
        assert process.stderr.readline().startswith("reconstructor: scheduling: ")
        assert Exchange(hub).image_of(measurement(1, golf.sensor[30])).valid_sums == 1024
        process.send_signal(number)
        out, err = process.communicate(timeout=240)
    assert (process.returncode, out, err) == (0, "", "")


@pytest.mark.heavy
def test_wrong_option_is_one_line() -> None:
    verb = [sys.executable, "-m", "skin", "reconstruct", "--penalty-n", "-1"]
    done = subprocess.run(verb, capture_output=True, text=True, check=False, timeout=240)
    assert done.returncode == 2
    assert done.stderr.startswith("skin: ")
    assert done.stderr.count("\n") == 1
