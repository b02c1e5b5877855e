"""A plain subscriber in Python, for who does without tilth.client: prints each estimate as it comes.

    python examples/subscriber.py tcp/127.0.0.1:7447 tilth/jd7930-parker500 [ESTIMATES]

What is absent from a message is not a number, and never 0.0: Protobuf's own getters say 0.0 for it. The
client (docs/client.md) also says what is too old to be used; this example does not.
"""

import json
import math
import sys
import threading

import zenoh
from google.protobuf.message import Message

from tilth.schemas.proto import tilth_pb2  # or what `protoc --python_out=. tilth.proto` makes

SILENT_S = 3.0


def number(message: Message, field: str) -> float:
    """The value of an `optional` field, NaN where it is not given."""
    return float(getattr(message, field)) if message.HasField(field) else math.nan


def sentence(row: tilth_pb2.Parameter) -> str:
    """Such as: C_af=2.02e+05 sd=9.1e+03 ESTIMATED 0.4 s."""
    status = tilth_pb2.ParameterStatus.Name(row.status)
    value, sd, age_s = (number(row, field) for field in ("value", "sd", "age_s"))
    return f"{row.name}={value:.4g} sd={sd:.2g} {status} {age_s:.1f} s {row.reason}".rstrip()


def say_what_is_heard(session: zenoh.Session, base: str) -> None:
    """For who has named another machine, or a tractor where only a simulation runs."""
    tokens = (str(reply.ok.key_expr) for reply in session.liveliness().get("**/alive") if reply.ok)
    found = sorted(token.removesuffix("/alive") for token in tokens)
    if base not in found:
        sys.stderr.write(f"nothing from {base}; heard: {', '.join(found) or 'no daemon at all'}\n")


def main() -> int:
    if len(sys.argv) < 3:
        sys.stderr.write("subscriber.py ENDPOINT PREFIX/MACHINE [ESTIMATES]\n")
        return 2
    endpoint, base, *most = sys.argv[1:]
    remaining = int(most[0]) if most else -1
    config = zenoh.Config()
    for key, value in (
        ("mode", "client"),
        ("scouting/multicast/enabled", False),
        ("connect/endpoints", [endpoint]),
    ):
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        unheard = threading.Timer(SILENT_S, say_what_is_heard, (session, base))
        unheard.start()
        estimates = session.declare_subscriber(f"{base}/soil_tire")
        for sample in estimates:
            if str(sample.encoding) == "application/protobuf;tilth.SoilTireEstimate":
                estimate = tilth_pb2.SoilTireEstimate.FromString(sample.payload.to_bytes())
                sys.stdout.write("; ".join(map(sentence, estimate.parameters)) + "\n")
                sys.stdout.flush()
                remaining -= 1
            if remaining == 0:
                break
        unheard.cancel()
    return 0


if __name__ == "__main__":
    sys.exit(main())
