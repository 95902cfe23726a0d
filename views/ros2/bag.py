"""A recording as a bag of ROS 2: MCAP with CDR and the definitions of the types, and ``metadata.yaml``."""

from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from canskin.errors import RunError
from health.state import ViewState
from recording.mcap_file import Warn, read_messages
from skin.layout import Layout
from skin.wall_times import CLOCKS, recorded_wall_times
from views.ros2.bridge import DIAGNOSTICS_S
from views.ros2.names import Node, Qos
from views.ros2.topics import DIAGNOSTIC_ARRAY, SKIN_TOPICS, RosTopic, Translator
from views.ros2.types import encoded, store

#: Version of the bags: that of Jazzy. Newer distributions read it, too.
_BAG_VERSION: Final = 9


def write_bag(source: Path, folder: Path, layout: Layout, warn: Warn) -> dict[str, int]:
    """Write the messages of a recording as a bag, with the topics that ``skin ros2`` would have published.

    Each message has the time at which the recorder got the message of the fabric; stamps in headers are sampling
    instants.

    Parameters
    ----------
    folder : pathlib.Path
        New folder of the bag.

    Returns
    -------
    dict of str to int
        Number of messages by topic.

    Raises
    ------
    RunError
        If the recording holds no messages.
    OSError
        If the bag cannot be written.
    """
    store()
    # The name of the folder is in the bag. After an error nothing is left of either.
    with TemporaryDirectory(dir=folder.resolve().parent, prefix=".", suffix=".part") as draft:
        made = _write(source, Path(draft) / folder.name, layout, warn)
        (Path(draft) / folder.name).rename(folder)
    return made


def _write(source: Path, folder: Path, layout: Layout, warn: Warn) -> dict[str, int]:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    node = Node(0, "", f"/{layout.name}", "canskin")
    translator = Translator(layout, layout.name, ViewState(layout), wall=recorded_wall_times(source))
    made: Counter[str] = Counter()
    connections: dict[RosTopic, Any] = {}
    bag = Writer(folder, version=_BAG_VERSION, storage_plugin=StoragePlugin.MCAP)
    bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)

    def write(topic: RosTopic, time_ns: int, content: Any) -> None:
        name = node.full_name(topic.name)
        if topic not in connections:
            offered = [_offered(topic.qos)]
            connections[topic] = bag.add_connection(
                name, topic.ros_type, typestore=store(), offered_qos_profiles=offered
            )
        bag.write(connections[topic], time_ns, encoded(topic.ros_type, content))
        made[name] += 1

    with bag:
        due_s = 0.0
        for _, time_ns, message in read_messages(source, [each for each in SKIN_TOPICS if each is not CLOCKS], warn):
            now_s = time_ns * 1e-9
            for topic, make in translator.take(message, now_s):
                write(topic, time_ns, make())
            if now_s >= due_s:
                due_s = now_s + DIAGNOSTICS_S
                write(DIAGNOSTIC_ARRAY, time_ns, translator.diagnostics(now_s, time_ns))
    if not made:
        raise RunError(f"{source}: holds no messages of the services, frames at most: play it with 'skin replay --out'")
    return dict(made)


def _offered(qos: Qos) -> Any:
    """Return a quality of service as bags tell it."""
    from rosbags.interfaces import Qos as BagQos
    from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(9223372036, 854775807)
    return BagQos(
        history=QosHistory.KEEP_LAST,
        depth=qos.depth,
        reliability=QosReliability.BEST_EFFORT if qos.best_effort else QosReliability.RELIABLE,
        durability=QosDurability.VOLATILE,
        deadline=forever,
        lifespan=forever,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )
