"""The session of a client and the threads that hear over it."""

import queue
import socket
import threading

from loopback import PATIENCE_S, free_port

from tilth.client.link import Link, open_session


def test_a_closed_link_has_no_thread_and_begins_none() -> None:
    """A thread within Zenoh while Python is taken down ends the process by a signal: an answer that comes
    while the link closes must not begin one."""
    heard: queue.SimpleQueue[str] = queue.SimpleQueue()
    link = Link(open_session(f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"))
    begun = set(threading.enumerate())
    link.hear(["one"], heard.put)
    assert heard.get(timeout=PATIENCE_S) == "one"
    link.hear(link.session.declare_subscriber("tilth/test"), lambda sample: None)
    link.close()
    link.hear(["late"], heard.put)
    assert set(threading.enumerate()) <= begun and heard.empty()  # others' threads may end meanwhile
