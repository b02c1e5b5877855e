"""Nobody gets more than a share, nobody at the machine is kept out, and places are given back."""

import threading
from collections import Counter
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilth.schemas.limiter import LOCAL, UNKNOWN, Limiter, asked_by, of_address

MOST, EACH = 6, 3
CLIENTS = (LOCAL, UNKNOWN, "10.0.0.1", "10.0.0.2", "reader-1")


@given(st.lists(st.tuples(st.sampled_from(CLIENTS), st.booleans()), max_size=60))
def test_shares(steps: list[tuple[str, bool]]) -> None:
    limiter, held = Limiter(MOST, EACH, "marks"), Counter[str]()
    for client, enters in steps:
        if enters:
            refused = limiter.enter(client)
            others = held.total() - held[LOCAL]
            full = held[client] >= EACH or (client != LOCAL and others >= MOST)
            assert bool(refused) == full
            assert not refused or "too many marks at a time" in refused
            held[client] += not refused
        elif held[client]:
            limiter.leave(client)
            held[client] -= 1
    assert all(count <= EACH for count in held.values()) and held.total() - held[LOCAL] <= MOST


@given(st.lists(st.sampled_from(CLIENTS), min_size=1, max_size=60))
def test_who_comes_last_gets_a_place_where_that_is_fair(clients: list[str]) -> None:
    limiter, held = Limiter(MOST, EACH), Counter[str]()
    for client in clients:
        full = limiter.enter(client)
        if full and (owner := limiter.in_the_way(client)) is not None:
            assert owner == client or (owner != LOCAL and held[owner] > held[client] + 1)
            limiter.leave(owner)
            held[owner] -= 1
            full = limiter.enter(client)
            assert not full
        elif full:  # only where all others have one too many for nobody
            assert client != LOCAL and max(held[one] for one in CLIENTS if one != LOCAL) <= held[client] + 1
        held[client] += not full
    assert held[LOCAL] == min(EACH, clients.count(LOCAL))


def test_threads_take_no_place_twice() -> None:
    limiter, given_out = Limiter(50, 50, lock=threading.Lock()), list[str]()
    threads = [
        threading.Thread(target=lambda: given_out.extend(limiter.enter("a") for _ in range(20)))
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert given_out.count("") == 50 and len(given_out) == 160


@pytest.mark.parametrize(("address", "client"), [
    ("127.0.0.1", LOCAL), ("127.8.9.1", LOCAL), ("::1", LOCAL), ("::ffff:127.0.0.1", LOCAL), ("", LOCAL),
    ("10.0.0.7", "10.0.0.7"), ("fe80::1%eth0", "fe80::1%eth0"), ("somewhere", "somewhere"),
])  # fmt: skip
def test_who_is_at_an_address(address: str, client: str) -> None:
    assert of_address(address) == client


def link(zid: str, dst: str, key: str | None = None) -> Any:
    return SimpleNamespace(zid=zid, dst=dst, auth_identifier=key)


@pytest.mark.parametrize(("said", "links", "client"), [
    (None, [], LOCAL),
    (None, [link("a", "tcp/127.0.0.1:4000")], LOCAL),
    (None, [link("a", "tcp/127.0.0.1:4000"), link("b", "tls/10.0.0.1:4000")], UNKNOWN),
    ("a", [link("a", "tcp/127.0.0.1:4000"), link("b", "tls/10.0.0.1:4000")], LOCAL),
    ("b", [link("a", "tcp/127.0.0.1:4000"), link("b", "tls/10.0.0.1:4000")], "10.0.0.1"),
    ("b", [link("b", "tls/[fe80::1]:4000", "reader-1")], "reader-1"),
    ("forged", [link("b", "tls/10.0.0.1:4000")], UNKNOWN),
])  # fmt: skip
def test_who_asks_over_zenoh(said: str | None, links: list[Any], client: str) -> None:
    info = SimpleNamespace(source_id=SimpleNamespace(zid=said)) if said else None
    session = SimpleNamespace(info=SimpleNamespace(links=lambda: links))
    assert asked_by(SimpleNamespace(source_info=info), session) == client
