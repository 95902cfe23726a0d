"""What the tests of the client share. They use nothing of the application, and run on Python 3.10, too."""

import logging
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from canskin.description import Description
from canskin.errors import LOG
from canskin.messages import Contact, Contacts, Image, Label, Measurement

ROWS, COLUMNS, BLOCKS = 4, 4, 2


class Log(logging.Handler):
    """The client's warnings, as lines."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []
        self._changed = threading.Condition()

    def emit(self, record: logging.LogRecord) -> None:
        with self._changed:
            self.lines.append(f"{record.__dict__['service']}: {record.getMessage()}")
            self._changed.notify_all()

    def wait_for(self, *expected: str) -> None:
        """Wait until every expected text begins a line."""
        with self._changed:
            all_there = self._changed.wait_for(
                lambda: all(any(line.startswith(text) for line in self.lines) for text in expected), 20
            )
            assert all_there, self.lines


@pytest.fixture
def log() -> Iterator[Log]:
    lines = Log()
    logging.getLogger(LOG).addHandler(lines)
    yield lines
    logging.getLogger(LOG).removeHandler(lines)


def description(boot_id: str = "") -> Description:
    """Return a skin of 4 x 4 taxels in two blocks: block 0 has the even taxels; each block sends rows 0 and 3."""
    order = np.r_[np.arange(0, 16, 2), np.arange(1, 16, 2)]
    kept = np.zeros((BLOCKS, 8), np.uint8)
    kept[:, [0, 3]] = 1
    return Description(
        name="palm",
        rows=ROWS,
        columns=COLUMNS,
        pitch_m=0.004,
        blocks=BLOCKS,
        sums=4,
        order=order.astype("<u4").tobytes(),
        kept=kept.tobytes(),
        newton_per_count=0.001,
        force_max_n=1.0,
        rate_hz=100.0,
        sending="synchronous",
        fingerprint="0123456789abcdef",
        boot_id=boot_id,
    )


def measurement(cycle: int, valid: bytes = bytes((1, 1)), **changed: object) -> Measurement:
    about: dict[str, object] = {
        "cycle": cycle,
        "sync_counter": 1,
        "sampled_mono_ns": at_ns(cycle),
        "sampled_error_ns": 2000,
        "wall_offset_ns": 7_000_000_000,
        "sums": np.array((10, 20, 30, 40), "<i4").tobytes(),
        "valid": valid,
        "fingerprint": "0123456789abcdef",
    }
    return Measurement(**{**about, **changed})


def image(cycle: int, valid: bytes = bytes((1, 1))) -> Image:
    return Image(
        cycle=cycle,
        sync_counter=1,
        sampled_mono_ns=at_ns(cycle),
        sampled_error_ns=2000,
        published_mono_ns=at_ns(cycle) + 1,
        pixels=np.arange(16, dtype="<f4").tobytes(),
        valid=valid,
        valid_sums=4,
        solve_s=0.001,
    )


def contacts(cycle: int, force_n: float = 0.5, *, blind: bool = False) -> Contacts:
    touch = Contact(
        identity=1,
        row=1.0,
        column=2.0,
        force_n=force_n,
        peak_n=0.2,
        taxels=4,
        top=0,
        bottom=1,
        left=1,
        right=2,
        onset_mono_ns=5,
    )
    return Contacts(
        cycle=cycle,
        sync_counter=1,
        sampled_mono_ns=at_ns(cycle),
        contacts=[] if blind else [touch],
        ended=[],
        find_s=0.0,
        blind=blind,
    )


def label(cycle: int, name: str = "cup", *, blind: bool = False) -> Label:
    return Label(
        cycle=cycle,
        sync_counter=1,
        sampled_mono_ns=at_ns(cycle),
        label=name,
        confidence=0.9,
        valid_sums=4,
        blind=blind,
    )


def at_ns(cycle: int) -> int:
    """Return the sampling instant of a cycle: one each 10 ms."""
    return 10_000_000 * cycle
