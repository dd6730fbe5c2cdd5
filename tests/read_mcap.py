"""Reads a recording with a reader that is not ours and prints what is in it, one line each.

Every message is decoded. Exits with an error if a topic is not Foxglove's protobuf, or if the index does not count right.

    pip install mcap mcap-protobuf-support
    python3 tests/read_mcap.py run.mcap
"""

import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def main(path):
    counts = {}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        statistics = reader.get_summary().statistics
        for metadata in reader.iter_metadata():
            print("metadata", metadata.name, *sorted(metadata.metadata))
        for attachment in reader.iter_attachments():
            print("attachment", attachment.name, attachment.media_type)
        for schema, channel, _, message in reader.iter_decoded_messages():
            assert schema.name.startswith("foxglove."), schema.name
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            assert type(message).__name__ == schema.name.removeprefix("foxglove.")
            if channel.topic.startswith("/camera/"):
                assert message.data, "an image has pixels"
            key = (channel.topic, schema.name)
            counts[key] = counts.get(key, 0) + 1
    assert sum(counts.values()) == statistics.message_count
    for (topic, schema), count in sorted(counts.items()):
        print("topic", topic, schema, count)


if __name__ == "__main__":
    main(sys.argv[1])
