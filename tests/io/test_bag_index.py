# SPDX-License-Identifier: MIT
"""Parts of rosbags that it does not document: the index of a bag, and its compression."""

from pathlib import Path

import pytest

pytest.importorskip("rosbags")

from bags import KINDS, START, STEP, TOPIC, messages, structured, text, write_bag

from salsanext_cli.io.bag_index import compression_of, message_times, storage_count

pytestmark = pytest.mark.private
POINTS = [structured(seed=seed) for seed in range(3)]
OTHERS = [("/chatter", START + 1, text), ("/chatter", START + 3 * STEP, text)]


def times_of_messages(reader, topic):
    """Return the times of a topic by the public interface, which reads all messages."""
    return [time for connection, time, _ in reader.messages() if connection.topic == topic]


def opened(path: Path):
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    return AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("topic", [TOPIC, "/chatter", "/absent"])
def test_the_index_has_the_times_that_the_messages_have(tmp_path, kind, topic):
    path = write_bag(tmp_path, kind, [*messages(POINTS), *OTHERS])
    for source in {path, path if kind == ".bag" else path.parent}:
        with opened(source) as reader:
            times = sorted(message_times(reader, lambda c: c.topic == topic))
            assert times == sorted(times_of_messages(reader, topic))
            assert storage_count(reader) == (1 if source.is_dir() else 0)


@pytest.mark.parametrize(
    ("kind", "compression"),
    [
        *((kind, "") for kind in KINDS),
        *((".bag", "BZ2"), (".bag", "LZ4"), (".db3", "FILE"), (".db3", "MESSAGE")),
        *((".mcap", "FILE"), (".mcap", "MESSAGE"), (".mcap", "STORAGE")),
    ],
)
def test_the_compression_is_the_one_that_the_bag_was_written_with(tmp_path, kind, compression):
    path = write_bag(tmp_path, kind, messages(POINTS), compression=compression)
    with opened(path if kind == ".bag" else path.parent) as reader:
        assert compression_of(reader) == compression


def test_an_index_that_leads_elsewhere_is_refused(tmp_path):
    path = write_bag(tmp_path, ".mcap", messages(POINTS))
    with opened(path) as reader:
        (single,) = reader.readers
        for chunk in single.storage.chunks:
            offsets = chunk.message_index_offsets
            offsets.update({key: offset + 1 for key, offset in offsets.items()})
        with pytest.raises(ValueError, match="misplaced"):
            list(message_times(reader, lambda c: c.topic == TOPIC))
