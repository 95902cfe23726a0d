"""Response times: published examples, a verified analysis as oracle, and a simulated bus that never exceeds them."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from response_time_analysis import fp
from response_time_analysis.model import (
    WCET,
    FullyNonPreemptive,
    IdealProcessor,
    PeriodicWithJitter,
    Priority,
    Task,
    taskset,
)

from bandwidth.response import UNBOUNDED, blocking_ns, response_times_ns
from bus.simulated_bus import SimulatedBus
from canskin.errors import InputError
from dbc.frame import BRS, FD, FD_LENGTHS, Frames, frames
from dbc.frame_bits import INTERMISSION_BITS, frame_time_ns

Times = npt.NDArray[np.int64]
MS = 1_000_000


def bound(times: list[int], periods: list[int], jitters: list[int] | None = None, **options: int) -> list[int]:
    jitter = jitters or [0] * len(times)
    return response_times_ns(np.array(times), np.array(periods), np.array(jitter), **options).tolist()


def test_the_example_that_refuted_the_analysis_of_1994() -> None:
    """Three messages of 1 ms: the second instance of the last one waits longer than the first."""
    found = bound([MS] * 3, [5 * MS // 2, 7 * MS // 2, 7 * MS // 2], bit_ns=8000)
    assert found == [2 * MS, 3 * MS, 7 * MS // 2]


def test_errors_cost_an_error_frame_and_the_longest_frame_again() -> None:
    times, periods = [65_000, 135_000, 95_000], [10 * MS] * 3
    plain, disturbed = bound(times, periods), bound(times, periods, error_interval_ns=10 * MS)
    assert [b - a for a, b in zip(plain, disturbed, strict=True)] == [
        31_000 + 65_000,
        31_000 + 135_000,
        31_000 + 135_000,
    ]


def test_no_bound_when_higher_priorities_ask_for_the_whole_bus() -> None:
    assert bound([MS, MS, MS], [3 * MS, 2 * MS, 4 * MS]) == [2 * MS, 3 * MS, UNBOUNDED]
    assert bound([MS], [2 * MS], error_interval_ns=2 * MS) == [UNBOUNDED]


@pytest.mark.parametrize(
    "wrong", [{"time": [0]}, {"period": [0]}, {"jitter": [-1]}, {"jitter": [0, 0]}, {"bit_ns": 0}, {"errors": -1}]
)
def test_wrong_numbers_are_refused(wrong: dict[str, list[int]]) -> None:
    with pytest.raises(InputError, match="expected"):
        response_times_ns(
            np.array(wrong.get("time", [1])),
            np.array(wrong.get("period", [9])),
            np.array(wrong.get("jitter", [0])),
            bit_ns=wrong.get("bit_ns", 1),  # type: ignore[arg-type]
            error_interval_ns=wrong.get("errors", 0),  # type: ignore[arg-type]
        )


messages = st.lists(st.tuples(st.integers(1, 30), st.integers(20, 400), st.integers(0, 300)), min_size=1, max_size=7)


@pytest.mark.heavy
@settings(max_examples=300, deadline=None)
@given(messages)
def test_agrees_with_the_analyses_that_prosa_verified(drawn: list[tuple[int, int, int]]) -> None:
    """The oracle counts whole bits, blocks one bit less, and has no jitter of the message's own in the response."""
    time, period, jitter = (np.array(column) for column in zip(*drawn, strict=True))
    level = np.cumsum(time / period)
    for place in range(len(time)):
        mine = jitter.copy()
        mine[place] = 0
        ours = response_times_ns(time, period, mine, bit_ns=1, blocked_ns=np.maximum(blocking_ns(time) - 1, 0))
        if level[place] >= 1:
            assert ours[place] == UNBOUNDED
        else:
            assert ours[place] == oracle(time, period, mine, place)


def oracle(time: Times, period: Times, jitter: Times, place: int) -> int:
    tasks = [
        Task(
            PeriodicWithJitter(period=int(period[each]), jitter=int(jitter[each])),
            FullyNonPreemptive(WCET(int(time[each]))),
            None,
            Priority(len(time) - each),
        )
        for each in range(len(time))
    ]
    solution = fp.rta(taskset(*tasks), tasks[place], IdealProcessor())
    assert solution.bound_found()
    return int(solution.response_time_bound)


class TaskSet:
    """Random messages of one bus: every frame's bits are drawn once, so that its time is exact."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        self.random = random
        count = int(random.integers(2, 8))
        self.frames = frames(count)
        self.frames["can_id"] = np.sort(random.choice(0x7FF, count, replace=False))
        is_fd = random.random(count) < (0.5 if seed % 3 == 0 else 0.0)
        self.frames["flags"] = np.where(is_fd, FD | BRS, 0)
        self.frames["length"] = np.where(is_fd, random.choice(FD_LENGTHS, count), random.integers(0, 9, count))
        self.frames["port"] = np.arange(count)
        for each in self.frames:
            each["data"][: each["length"]] = random.integers(0, 256, int(each["length"]))
        self.bitrates = 1_000_000, 5_000_000
        self.time = frame_time_ns(self.frames, *self.bitrates)
        share = random.dirichlet(np.ones(count)) * random.uniform(0.2, 0.98)
        self.period = np.maximum(np.rint(self.time / share), self.time).astype(np.int64)
        self.jitter = np.rint(self.period * random.uniform(0, 0.8, count) * (random.random(count) < 0.5)).astype(
            np.int64
        )

    def bound(self) -> Times:
        return response_times_ns(self.time, self.period, self.jitter)

    def released(self, horizon_ns: int) -> tuple[Frames, Times]:
        """Return what is queued until `horizon_ns`, and the event of each message.

        One message begins just before all others are queued: when that one has a lower priority and the longest
        frame, this is the critical instant of those above it.
        """
        victim = int(self.random.integers(len(self.time)))
        lower = self.time[victim + 1 :]
        opener = victim + 1 + int(lower.argmax()) if lower.size else -1
        events, queued, which = [], [], []
        for place in range(len(self.time)):
            period, jitter = int(self.period[place]), int(self.jitter[place])
            number = np.arange(horizon_ns // period + 1)
            event = MS + number * period - jitter  # the first is held back by its whole jitter, the others by none
            queue = event.copy()
            queue[0] = MS
            if place == opener:
                queue[0] = event[0] = MS - 1
            late = self.random.integers(0, jitter + 1, len(number)) if place > victim else 0
            queue[1:] = np.maximum(event + late, queue[0])[1:]
            queue = np.maximum.accumulate(queue)
            events.append(event), queued.append(queue), which.append(np.full(len(number), place))
        released = self.frames[np.concatenate(which)]
        released["time_ns"] = np.concatenate(queued)
        order = np.argsort(released["time_ns"], kind="stable")
        return released[order], np.concatenate(events)[order]

    def simulate(self, horizon_ns: int) -> Times:
        """Return the longest response of each message on the arbitrated bus; -1 where none was sent."""
        released, events = self.released(horizon_ns)
        bus = SimulatedBus(*self.bitrates)
        sender = bus.attach("sender", queue_size=len(released))
        bus.submit(bus.attach("listener"), frames(0))
        assert bus.submit(sender, released) == len(released)
        ended = bus.run_until().frames
        assert len(ended) == len(released)
        worst = np.full(len(self.time), -1, np.int64)
        intermission_ns = round(INTERMISSION_BITS * 1e9 / self.bitrates[0])
        for place in range(len(self.time)):
            mine = np.sort(events[released["port"] == place])
            done = ended["time_ns"][ended["port"] == place] + intermission_ns
            worst[place] = (done - mine).max()
        return worst


def compare(seeds: range) -> float:
    """Return how near the simulation comes to the bound, which it must not exceed."""
    nearest = 0.0
    for seed in seeds:
        tasks = TaskSet(seed)
        limit = tasks.bound()
        assert (limit < UNBOUNDED).all()
        seen = tasks.simulate(int(min(4 * tasks.period.max(), 60 * tasks.period.min())))
        assert (seen <= limit).all(), (seed, seen, limit)
        nearest = max(nearest, float((seen / limit).max()))
    return nearest


def test_simulated_responses_stay_below_the_bound_and_reach_it() -> None:
    assert compare(range(300)) > 0.9


@pytest.mark.slow
def test_many_task_sets() -> None:
    assert compare(range(300, 2300)) > 0.9
