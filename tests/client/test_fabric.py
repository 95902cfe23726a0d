"""The fabric: messages, mailboxes, liveliness, and what happens to garbage."""

import queue
import threading
from collections.abc import Iterator
from unittest import mock

import msgspec
import numpy as np
import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from canskin import fabric as fabric_module
from canskin import session as session_module
from canskin.calibration_messages import CALIBRATION, CalibrationReply, CalibrationRequest
from canskin.errors import BusError, Stopped
from canskin.fabric import Fabric, Mailbox, Missed, Origin, Reply, Shared
from canskin.messages import (
    IMAGE,
    LABEL,
    MARK,
    MEASUREMENT,
    CycleMeasurement,
    Image,
    Label,
    Mark,
    SteppedMeasurement,
    Topic,
)
from canskin.peers import Peer, Roll, new_peer, peer_of_key
from canskin.session import MESSAGE_MAX, open_client, open_hub
from tests.client.conftest import Log
from tests.messages import image, label
from tests.processes import PATIENCE_S


@pytest.fixture
def hub(endpoint: str) -> Iterator[Fabric]:
    fabric = Fabric("test", "hub", endpoint, hub=True)
    yield fabric
    fabric.close()


def send_until_heard(
    sender: Fabric, heard: threading.Event, topic: Topic = LABEL, message: msgspec.Struct | None = None
) -> None:
    """Publish until a subscriber, whose declaration takes its time, has heard."""
    for cycle in range(round(PATIENCE_S / 0.02)):
        sender.publish(topic, message or label(cycle))
        if heard.wait(0.02):
            return
    pytest.fail("nothing was heard")


def test_messages_tell_their_publisher_and_number(hub: Fabric, endpoint: str) -> None:
    heard = threading.Event()
    origins: list[Origin] = []

    def handler(_content: bytes, origin: Origin | None) -> None:
        assert origin is not None
        origins.append(origin)
        if len(origins) == 3:
            heard.set()

    other = Fabric("test", "other", endpoint)
    hub.subscribe_bytes(LABEL, handler)
    send_until_heard(other, heard)
    other.close()
    assert len({each.publisher for each in origins}) == 1
    assert np.diff([each.number for each in origins]).tolist() == [1] * (len(origins) - 1)


@pytest.mark.parametrize("attachment", [b"", b"abc", b"abc-", b"-7", b"abc-x", b"a\xff-1", b"abc-" + b"9" * 5000])
def test_an_attachment_of_another_program_is_no_origin(attachment: bytes) -> None:
    assert fabric_module._origin_of(zenoh.ZBytes(attachment)) is None


@pytest.mark.heavy
def test_an_answer_to_someone_who_has_left_is_no_error(hub: Fabric, endpoint: str, log: Log) -> None:
    replies: queue.Queue[Reply] = queue.Queue()
    hub.answer(CALIBRATION, lambda _request, reply: replies.put(reply))
    other = Fabric("test", "other", endpoint)
    with pytest.raises(BusError, match="no service of skin 'test' answers"):
        other.ask(CALIBRATION, CalibrationRequest(action="tare"), 1.0)
    reply = replies.get(timeout=PATIENCE_S)
    other.close()
    for _ in range(2):  # the second is one too many
        reply(CalibrationReply(is_done=True, text=""))
    assert any("hub: an answer to 'calibration' is lost" in line for line in log.lines)


def test_an_answer_that_cannot_be_decoded_is_named(hub: Fabric, endpoint: str) -> None:
    hub.answer(CALIBRATION, lambda _request, reply: reply(label(1)))
    other = Fabric("test", "other", endpoint)
    with pytest.raises(BusError, match="of another version of canskin"):
        other.ask(CALIBRATION, CalibrationRequest(action="tare"), PATIENCE_S)
    other.close()


def test_a_message_is_encoded_only_while_somebody_reads_its_topic(
    hub: Fabric, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fabric_module, "FRESH_S", 0.0)
    other, origins, heard = Fabric("test", "other", endpoint), list[Origin | None](), threading.Event()
    with mock.patch.object(other, "_encoder") as encoder:
        for cycle in range(5):
            other.publish(LABEL, label(cycle))
    assert not encoder.encode.called
    hub.subscribe_bytes(LABEL, lambda _content, origin: (origins.append(origin), heard.set()))
    send_until_heard(other, heard)
    other.close()
    assert origins[0] is not None
    assert origins[0].number > 5  # whoever has read before, and lost the connection, sees a gap


def test_the_first_message_of_a_publisher_comes(hub: Fabric, endpoint: str) -> None:
    heard = threading.Event()
    hub.subscribe(LABEL, lambda _message: heard.set())
    other = Fabric("test", "other", endpoint)
    other.publish(LABEL, label(1))
    assert heard.wait(PATIENCE_S)
    other.close()


def test_a_reader_of_the_newest_decodes_no_other_and_counts_what_did_not_come(hub: Fabric, endpoint: str) -> None:
    other, came = Fabric("test", "other", endpoint), threading.Semaphore(0)
    mailbox = other.mailbox(LABEL, 1)
    kept = other._session.declare_subscriber("canskin/test/label", lambda _: came.release())
    assert mailbox.get(0.01) is None
    sends = hub._session.declare_publisher("canskin/test/label")
    matched = threading.Event()
    listener = sends.declare_matching_listener(lambda status: status.matching and matched.set())
    assert matched.wait(PATIENCE_S)
    for number, content in enumerate((b"\xc1", b"\xc1", *2 * [msgspec.msgpack.encode(label(3))]), 1):
        sends.put(content, attachment=f"hub-{2 * number}")
    assert all(came.acquire(timeout=PATIENCE_S) for _ in range(4))
    message = mailbox.get(PATIENCE_S)
    assert message is not None
    assert message.cycle == 3
    assert other.missed.counts()["label"] >= 2
    assert (other.malformed, other.overruns) == (0, 0)  # a mailbox for the newest loses none
    kept.undeclare()
    listener.undeclare()
    other.close()
    assert mailbox.get(PATIENCE_S) is None


GARBAGE = {
    "no message": b"\xc1 garbage",
    "text that is no UTF-8": b"\x81\xa5label\xa1\xff",
    "lists in lists": b"\x81\xa5other" + 100_000 * b"\x91" + b"\0",
}


@pytest.mark.parametrize("garbage", GARBAGE.values(), ids=GARBAGE)
def test_garbage_is_counted_and_other_skins_are_not_heard(hub: Fabric, endpoint: str, garbage: bytes) -> None:
    heard = threading.Event()
    hub.subscribe(LABEL, lambda _message: heard.set())
    other = Fabric("test", "other", endpoint)
    stranger = Fabric("another", "other", endpoint)
    session: zenoh.Session = other._session
    for _ in range(round(PATIENCE_S / 0.02)):
        session.put("canskin/test/label", garbage)
        stranger.publish(LABEL, label(0))
        if hub.malformed:
            break
        heard.wait(0.02)
    assert hub.malformed
    assert not heard.is_set()
    send_until_heard(other, heard)
    other.close()
    stranger.close()


def test_publishing_waits_for_nobody(hub: Fabric) -> None:
    hub.publish(LABEL, label(1))
    assert hub._publishers["label"].wire.congestion_control == zenoh.CongestionControl.DROP


def test_one_of_two_services_of_a_name_may_leave(hub: Fabric, endpoint: str) -> None:
    changed = threading.Condition()
    events: list[tuple[str, bool]] = []

    def handler(name: str, is_alive: bool) -> None:
        with changed:
            events.append((name, is_alive))
            changed.notify()

    def await_event(name: str, is_alive: bool) -> None:
        with changed:
            assert changed.wait_for(lambda: (name, is_alive) in events, PATIENCE_S)

    first, second = Fabric("test", "viewer", endpoint), Fabric("test", "viewer", endpoint)
    hub.watch(handler)
    first_sees: list[bool] = []
    first.watch(lambda name, is_alive: first_sees.append(is_alive) if name == "viewer" else None)
    await_event("viewer", True)
    second.close()
    later = Fabric("test", "later", endpoint)
    await_event("later", True)
    assert ("viewer", False) not in events
    assert False not in first_sees
    first.close()
    await_event("viewer", False)
    later.close()
    assert [event for event in events if event[0] == "viewer"] == [("viewer", True), ("viewer", False)]


def test_scheduling_is_told_while_the_service_stays(hub: Fabric, endpoint: str) -> None:
    peers: queue.Queue[tuple[Peer, bool]] = queue.Queue()
    changes: list[tuple[str, bool]] = []
    hub.watch(lambda name, is_alive: changes.append((name, is_alive)))
    hub.watch_peers(lambda peer, is_alive: peers.put((peer, is_alive)))
    other = Fabric("test", "other", endpoint, fingerprint="12ab")
    other.tell_scheduling("realtime")
    seen = []
    while not seen or seen[-1][1]:
        peer, is_alive = peers.get(timeout=PATIENCE_S)
        seen += [(peer, is_alive)] * (peer.service == "other")
    assert [(peer.scheduling, peer.fingerprint, is_alive) for peer, is_alive in seen] == [
        ("", "12ab", True),
        ("realtime", "12ab", True),
        ("", "12ab", False),
    ]
    assert ("other", False) not in changes
    other.close()


@given(st.lists(st.tuples(st.sampled_from("ab"), st.sampled_from("123"), st.booleans())))
def test_a_service_is_there_while_any_of_its_name_is(notes: list[tuple[str, str, bool]]) -> None:
    roll, there, told = Roll(), set[tuple[str, str]](), {"a": False, "b": False}
    for service, instance, is_there in notes:
        (there.add if is_there else there.discard)((service, instance))
        if roll.note(service, instance, is_there):
            told[service] = not told[service]
        assert told == {name: any(each == name for each, _ in there) for name in "ab"}
    assert {service for service in "ab" if roll.holds(service)} == {service for service, _ in there}


def test_who_sees_a_service_is_heard_by_it(hub: Fabric, endpoint: str) -> None:
    other, boxes = Fabric("test", "other", endpoint), list[Mailbox[Label]]()
    other.watch(lambda service, alive: other.publish(LABEL, label(1)) if (service, alive) == ("late", True) else None)
    late = Fabric("test", "late", endpoint, prepare=lambda fabric: boxes.append(fabric.mailbox(LABEL)))
    assert boxes[0].get(PATIENCE_S) is not None
    late.close()
    other.close()


def test_endpoint_in_use_is_one_clear_line(hub: Fabric, endpoint: str) -> None:
    with pytest.raises(BusError, match="cannot listen on tcp/127") as caught:
        Fabric("test", "second", endpoint, hub=True)
    assert "\n" not in str(caught.value)


def test_no_hub_is_one_clear_line(endpoint: str) -> None:
    with pytest.raises(BusError, match=r"^no hub at tcp/127.*: start 'skin gateway'"):
        Fabric("test", "lonely", endpoint, patience_s=0.2)


@pytest.mark.heavy
def test_hub_that_comes_later_is_found_and_both_are_told(
    endpoint: str, monkeypatch: pytest.MonkeyPatch, log: Log
) -> None:
    monkeypatch.setattr(session_module, "TRY_S", 0.05)
    monkeypatch.setattr(session_module, "SILENT_S", 0.0)
    hubs: list[Fabric] = []

    def start_hub() -> None:
        log.wait_for("early: waits")
        monkeypatch.setattr(session_module, "TRY_S", PATIENCE_S)
        hubs.append(Fabric("test", "hub", endpoint, hub=True))

    starting = threading.Thread(target=start_hub)
    starting.start()
    Fabric("test", "early", endpoint).close()
    starting.join()
    hubs[0].close()
    assert [line for line in log.lines if "has no keys" not in line] == [
        f"early: waits for the fabric's hub at {endpoint}, usually 'skin gateway'",
        "early: the hub is there",
    ]


@pytest.mark.heavy
def test_services_of_another_phi_are_named_once_and_of_another_skin_never(endpoint: str, log: Log) -> None:
    gateway = Fabric("palm", "gateway", endpoint, hub=True, fingerprint="aa")
    others = [
        Fabric("palm", "reconstructor", endpoint, fingerprint="bb"),
        Fabric("palm", "reconstructor", endpoint, fingerprint="bb"),
        Fabric("hand", "gateway", endpoint, fingerprint="cc"),
        Fabric("palm", "health", endpoint),
    ]
    expected = {
        "gateway: reconstructor has Φ bb, gateway has Φ aa: give both the same --layout",
        "reconstructor: gateway has Φ aa, reconstructor has Φ bb: give both the same --layout",
    }
    log.wait_for(*expected)
    assert sum("gateway: reconstructor has" in line for line in log.lines) == 1
    assert not [line for line in log.lines if "gateway: gateway" in line or "hand" in line]
    for fabric in (*others, gateway):
        fabric.close()


def test_what_a_service_says_of_itself_survives_its_key() -> None:
    peer = new_peer("palm", "gateway", "0123456789abcdef")
    assert peer.version
    assert peer_of_key(peer.key) == peer
    assert peer_of_key("canskin/palm/alive/gateway/8f00") == Peer("palm", "gateway", "8f00")
    newer = Peer("palm", "reconstructor", "1", "9.9", "0123456789abcdef")
    assert "reconstructor is canskin 9.9" in peer.difference(newer)
    for reads in ("viewer", "recorder", "client"):  # keys of a reader raise no alarm
        assert not peer.difference(msgspec.structs.replace(newer, service=reads))
    assert not peer.difference(Peer("palm", "viewer", "1"))


def test_a_stop_while_waiting_for_the_hub_ends_quietly(
    endpoint: str, monkeypatch: pytest.MonkeyPatch, log: Log
) -> None:
    monkeypatch.setattr(session_module, "TRY_S", 0.05)
    monkeypatch.setattr(session_module, "SILENT_S", 0.0)
    stop = threading.Event()
    stopping = threading.Thread(target=lambda: (log.wait_for("lonely: waits"), stop.set()))
    stopping.start()
    with pytest.raises(Stopped):
        Fabric("test", "lonely", endpoint, stop=stop)
    stopping.join()
    assert log.lines == [f"lonely: waits for the fabric's hub at {endpoint}, usually 'skin gateway'"]


def test_mailbox_keeps_the_newest_and_counts_the_rest() -> None:
    mailbox: Mailbox[Label] = Mailbox(2)
    for cycle in range(5):
        mailbox.put(label(cycle))
    first, second = mailbox.get(0), mailbox.get(0)
    assert first is not None
    assert second is not None
    assert (first.cycle, second.cycle, mailbox.overrun) == (3, 4, 3)


def test_a_mailbox_decodes_what_is_taken_and_passes_over_what_is_no_message() -> None:
    decoded: list[bytes] = []

    def decode(content: bytes) -> Label | None:
        decoded.append(content)
        return label(int(content)) if content.isdigit() else None

    mailbox = Mailbox(3, decode)
    for content in (b"1", b"2", b"garbage", b"4"):
        mailbox.put(content)
    taken = [mailbox.get(0.0) for _ in range(3)]
    assert [message and message.cycle for message in taken] == [2, 4, None]
    assert decoded == [b"2", b"garbage", b"4"]
    assert mailbox.get(0) is None


def test_a_wait_at_a_mailbox_ends_in_time_while_garbage_comes() -> None:
    mailbox: Mailbox[Label] = Mailbox(1, lambda _: None)
    is_over = threading.Event()

    def send() -> None:
        for _ in range(5000):
            mailbox.put(b"garbage")
            if is_over.wait(0.001):
                return

    sender = threading.Thread(target=send)
    sender.start()
    assert mailbox.get(0.5) is None
    assert sender.is_alive()
    is_over.set()
    sender.join()


@pytest.mark.parametrize("endpoint", ["bogus", "tcp/127.0.0.1", "tcp/host:99999", "tpc/host:7447", "unixpipe/"])
def test_endpoint_of_no_known_form_is_one_clear_line(endpoint: str) -> None:
    with pytest.raises(BusError, match=rf"expected an endpoint such as tcp/127\.0\.0\.1:7447, got '{endpoint}'"):
        Fabric("test", "lonely", endpoint)


def test_messages_that_did_not_come_are_counted_and_no_repetition_hides_them() -> None:
    missed = Missed()
    for number in (1, 2, 6, 4):  # 3 and 5 did not come, 4 came late
        missed.take("image", Origin("reconstructor", number))
    for _ in range(100):
        missed.take("image", Origin("noise", 1))
    missed.take("label", Origin("classifier", 7))
    assert missed.counts() == {"image": 2}


def test_a_message_beyond_the_limit_is_dropped_and_the_next_are_heard(endpoint: str) -> None:
    hub, sizes = open_hub(endpoint), queue.Queue[int]()
    subscriber = hub.declare_subscriber("canskin/**", lambda sample: sizes.put(len(sample.payload)))
    client = open_client(endpoint, "client", None, PATIENCE_S)
    for size in (MESSAGE_MAX + 1, 1):
        client.put("canskin/test/image", bytes(size))
    assert sizes.get(timeout=PATIENCE_S) == 1
    subscriber.undeclare()
    client.close()
    hub.close()


@pytest.fixture
def shared(monkeypatch: pytest.MonkeyPatch) -> Shared:
    shared = Shared()
    monkeypatch.setattr(Fabric, "shared", shared)
    return shared


def test_services_of_one_process_share_a_session_and_others_hear_each_message_once(
    endpoint: str, shared: Shared, monkeypatch: pytest.MonkeyPatch
) -> None:
    gateway, page = Fabric("test", "maker", endpoint, hub=True), Fabric("test", "page", endpoint)
    assert page._session is gateway._session is shared.session
    with monkeypatch.context() as patch:
        patch.setattr(Fabric, "shared", None)
        outside = Fabric("test", "outside", endpoint)
    own, other = page.mailbox(IMAGE), outside.mailbox(IMAGE)
    own_labels, other_labels = queue.Queue[Label](), queue.Queue[Label]()
    page.subscribe(LABEL, own_labels.put)
    outside.subscribe(LABEL, other_labels.put)
    heard = threading.Event()
    gateway.subscribe(MARK, lambda _: heard.set())
    send_until_heard(outside, heard, MARK, Mark(label="ring"))
    for cycle, publisher in enumerate((gateway, outside), 1):
        sent, told = image(cycle, sampled_mono_ns=cycle), label(cycle, sampled_mono_ns=cycle)
        publisher.publish(IMAGE, sent)
        publisher.publish(LABEL, told)
        here, there = own.get(PATIENCE_S), other.get(PATIENCE_S)
        assert here == there == sent
        assert (here is sent) is (publisher is gateway)  # handed over as it is
        assert own_labels.get(timeout=PATIENCE_S) == other_labels.get(timeout=PATIENCE_S) == told
    for late in (1, 2, 3):  # what is no newer than that of another publisher is refused
        gateway.publish(IMAGE, image(9, sampled_mono_ns=late))
        gateway.publish(LABEL, label(9, sampled_mono_ns=late))
    for newest in (own.get(PATIENCE_S), other.get(PATIENCE_S)):  # none came twice
        assert newest == image(9, sampled_mono_ns=3)
    newest_label = label(9, sampled_mono_ns=3)
    assert own_labels.get(timeout=PATIENCE_S) == other_labels.get(timeout=PATIENCE_S) == newest_label
    assert (page.late, outside.late) == (4, 4)
    gateway.answer(CALIBRATION, lambda _request, reply: reply(CalibrationReply(is_done=True, text="")))
    assert page.ask(CALIBRATION, CalibrationRequest(action="tare"), PATIENCE_S).is_done
    assert {each.service for each in outside.peers()} == {"maker", "page", "outside"}
    gateway.close()
    assert {each.service for each in outside.peers()} == {"page", "outside"}
    page.close()
    assert shared.session is None
    outside.close()


def test_a_service_that_enters_while_the_last_leaves_gets_an_open_session(shared: Shared) -> None:
    first, second, lock = mock.Mock(), mock.Mock(), mock.MagicMock(wraps=shared._lock)
    assert shared.enter(lambda: first) is first
    shared._lock, whole = lock, shared._lock

    def leave_before() -> None:
        shared._lock = whole
        shared.leave()

    lock.__enter__.side_effect = leave_before
    assert shared.enter(lambda: second) is second
    assert first.close.called
    assert not second.close.called
    assert shared.session is second


def test_a_handler_that_raises_is_told_and_called_again(endpoint: str, shared: Shared, log: Log) -> None:
    gateway, page = Fabric("test", "maker", endpoint, hub=True), Fabric("test", "page", endpoint)
    heard = queue.Queue[int]()

    def take(message: Label) -> None:
        heard.put(message.cycle)
        if message.cycle == 1:
            raise ValueError("no such label")

    page.subscribe(LABEL, take)
    for cycle in (1, 2):
        gateway.publish(LABEL, label(cycle))
        assert heard.get(timeout=PATIENCE_S) == cycle
    log.wait_for("page: a message was not taken: ValueError: no such label")
    page.close()
    gateway.close()


def test_two_readers_of_a_topic_hide_no_loss_of_each_other(hub: Fabric, endpoint: str) -> None:
    other, heard = Fabric("test", "other", endpoint), threading.Event()
    came = threading.Semaphore(0)
    for _ in range(2):
        other.subscribe(LABEL, lambda message: came.release() if message.cycle == 10**6 else heard.set())
    send_until_heard(hub, heard)
    next(hub._publishers["label"].numbers)  # is lost
    hub.publish(LABEL, label(10**6))
    assert all(came.acquire(timeout=PATIENCE_S) for _ in range(2))
    assert other.missed.counts() == {"label": 2}  # by each of them
    other.close()


def test_what_is_handed_over_cannot_be_changed() -> None:
    for message in (Image, CycleMeasurement, SteppedMeasurement):
        assert message.__struct_config__.frozen
        assert {field.type for field in msgspec.structs.fields(message)} <= {int, float, str, bytes}
    assert fabric_module._HANDED_OVER == (MEASUREMENT, IMAGE)
