# SPDX-License-Identifier: MIT
"""Messages through a pipe, also one that is cut off."""

import io
import pickle

from salsanext_cli.runs.loop.cluster.messages import FreePlaces, Joined, messages_from


def test_messages_end_where_the_other_process_has_ended():
    sent = [Joined(nodes=1, workers=2), FreePlaces(count=4)]
    content = b"".join(map(pickle.dumps, sent))
    assert [*messages_from(io.BytesIO(content))] == sent
    assert [*messages_from(io.BytesIO(content[:-1]))] == sent[:1]
    assert [*messages_from(io.BytesIO(b""))] == []
