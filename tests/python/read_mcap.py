"""Reads a recording of `furrow replay --mcap` as a stranger would: with the packages mcap and mcap-protobuf-support.

usage: read_mcap.py FILE

Exit code 1, with the reason, where topics, schemas, counts or times are not what they should be, or a message cannot
be decoded.
"""

import json
import math
import sys
from collections import Counter

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

SCHEMAS = {
    "/tf": "foxglove.FrameTransform",
    "/tf_static": "foxglove.FrameTransforms",
    "/field": "foxglove.SceneUpdate",
    "/robot/body": "foxglove.SceneUpdate",
    "/robot/motion": "furrow.Motion",
    "/interventions": "foxglove.SceneUpdate",
    "/metrics": "furrow.Outcome",
}
OF_A_LIDAR = {"scan": "foxglove.LaserScan", "points": "foxglove.PointCloud", "lines": "foxglove.SceneUpdate"}
JSON_SCHEMAS = ("furrow.Motion", "furrow.Outcome")
METADATA = ("job", "key", "seed", "engine", "scenario", "outcome", "digest", "time")
ONCE = ("/tf_static", "/field", "/robot/body", "/metrics")


def check(holds, what):
    if not holds:
        sys.exit(f"{sys.argv[1]}: {what}")


def decoded(reader):
    """Topic, log time [ns] and message of every message, in the order of the file."""
    protobuf = DecoderFactory()
    decoders = {}
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        if channel.message_encoding == "json":
            yield channel.topic, message.log_time, json.loads(message.data)
            continue
        if channel.id not in decoders:
            decoders[channel.id] = protobuf.decoder_for(channel.message_encoding, schema)
        check(decoders[channel.id] is not None, f"{channel.topic}: no decoder")
        yield channel.topic, message.log_time, decoders[channel.id](message.data)


def check_lidars(counts, lidars):
    for lidar in lidars:
        numbers = {counts[f"/lidar/{lidar}/{what}"] for what in OF_A_LIDAR}
        check(len(numbers) == 1 and 0 not in numbers, f"{lidar}: {numbers} scans, point clouds and lines")


def check_scan(topic, scan):
    check(len(scan.ranges) > 1 and scan.end_angle > scan.start_angle, f"{topic}: no beams")
    check(all(reading > 0.0 for reading in scan.ranges), f"{topic}: a range that is not positive")


def check_cloud(topic, cloud):
    check(cloud.point_stride == 12 and len(cloud.data) % 12 == 0, f"{topic}: torn points")
    check([field.name for field in cloud.fields] == ["x", "y", "z"], f"{topic}: fields")


def check_transform(topic, transform):
    turn = transform.rotation
    check(abs(math.hypot(turn.x, turn.y, turn.z, turn.w) - 1.0) < 1e-9, f"{topic}: no rotation")


def main(path):
    with open(path, "rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        channels = {channel.topic: summary.schemas[channel.schema_id] for channel in summary.channels.values()}
        lidars = sorted({topic.split("/")[2] for topic in channels if topic.startswith("/lidar/")})
        expected = SCHEMAS | {f"/lidar/{at}/{what}": name for at in lidars for what, name in OF_A_LIDAR.items()}
        check(lidars in (["back", "front"], ["front"]), f"LiDARs {lidars}")
        check({topic: schema.name for topic, schema in channels.items()} == expected, f"topics {sorted(channels)}")
        for schema in channels.values():
            encoding = "jsonschema" if schema.name in JSON_SCHEMAS else "protobuf"
            check(schema.encoding == encoding, f"{schema.name}: {schema.encoding}")
        records = {record.name: record.metadata for record in reader.iter_metadata()}
        check("furrow" in records, f"metadata {sorted(records)}")
        check(set(METADATA) <= set(records["furrow"]), f"metadata {sorted(records['furrow'])}")
        json.loads(records["furrow"]["scenario"])

        counts, last_ns, last_pose_ns, outcome = Counter(), 0, -1, None
        for topic, time_ns, message in decoded(reader):
            counts[topic] += 1
            check(time_ns >= last_ns, f"{topic}: {time_ns} ns after {last_ns} ns")
            last_ns = time_ns
            if topic.endswith("/scan"):
                check_scan(topic, message)
            elif topic.endswith("/points"):
                check_cloud(topic, message)
            elif topic == "/tf":
                check(time_ns > last_pose_ns, "/tf: two poses at a time")
                last_pose_ns = time_ns
                check_transform(topic, message)
            elif topic == "/metrics":
                outcome = message

    check(all(counts[topic] == 1 for topic in ONCE), f"counts {dict(counts)}")
    check(counts["/tf"] >= counts["/robot/motion"] > 0, f"counts {dict(counts)}")
    if any(topic.startswith("/lidar/") for topic in counts):
        check_lidars(counts, lidars)
    check(counts.total() == summary.statistics.message_count, "messages are missing")
    for key in ("outcome", "digest"):
        check(outcome[key] == records["furrow"][key], f"two words for the {key}")
    print(json.dumps({"seconds": last_ns / 1e9, "outcome": outcome["outcome"], "messages": dict(sorted(counts.items()))}))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
