"""Receivers are recognised by where they are, and what was known of them is not believed blindly."""

from dataclasses import replace
from itertools import permutations

import pytest
from logs import MACHINE
from restarted import NAMES, SECOND, Followed, drive, exchanged, from_s, right
from sampled import sampled

from tilth.estimator.snapshot import restore, snapshot
from tilth.schemas.can_id import split
from tilth.schemas.flow import Frame, Mount


@pytest.mark.parametrize("seconds", [3.0, 17.3, 30.0])
def test_without_any_knowledge_receivers_are_recognised_by_where_they_are(seconds: float) -> None:
    told = Followed(from_s(seconds, seconds + 8.0))
    assert told.wrong == 0 and told.whole > 15
    assert told.first_s is not None and told.first_s < 4.5  # five metres, and the lag of positions
    assert told.said("recognised by their positions")


def test_what_was_known_is_used_at_once_within_one_power_session() -> None:
    frames = from_s(20.0, 22.0)
    told = Followed(frames, exchanged([right()[m] for m in Mount], frames[0].t_ns - 20 * SECOND))
    assert told.wrong == 0 and told.first_s is not None and told.first_s < 1.2
    assert told.said("was silent for 20 s: receivers keep their addresses")


ORDERS = list(permutations(range(4)))


# In the sample: none, a pair, three and all four exchanged.
@pytest.mark.parametrize("order", sampled(ORDERS, ORDERS[::5]), ids=str)
def test_exchanged_addresses_give_no_wrong_pose(order: tuple[int, ...]) -> None:
    """Four alike receivers settle their addresses anew at each power-up."""
    now = [right()[mount] for mount in Mount]
    before = [now[i] for i in order]
    frames = from_s(20.0, 27.0)
    told = Followed(frames, exchanged(before))
    assert told.wrong == 0 and told.whole > 10
    assert told.said("other addresses than before" if before != now else "the addresses that they had before")
    # The same where it was taken for one power session.
    quick = Followed(from_s(20.0, 30.0), exchanged(before, frames[0].t_ns - 20 * SECOND))
    assert quick.wrong == 0 and quick.whole > 10
    assert quick.said("may have other addresses") == (before != now)


def test_a_claim_always_wins() -> None:
    frames = list(drive()[: next(i for i, f in enumerate(drive()) if f.t_ns - drive()[0].t_ns > 4 * SECOND)])
    now = [right()[mount] for mount in Mount]
    told = Followed(frames, exchanged(now[::-1], frames[0].t_ns - 20 * SECOND))
    assert told.wrong == 0 and told.whole > 10 and not told.said("by their positions")


def test_a_search_goes_on_from_a_stored_state() -> None:
    frames = from_s(20.0, 25.0)
    told, again = Followed([]), Followed([])
    for i, frame in enumerate(frames):
        if i % 500 == 0:
            again.state = restore(MACHINE, snapshot(again.state))
        told.frames = again.frames = frames
        told.take(frame)
        again.take(frame)
    assert told.whole > 5 and (told.whole, told.events) == (again.whole, again.events)


@pytest.mark.parametrize("wheel", [True, False])
def test_a_rig_in_reverse_is_not_taken_for_one_that_goes_forwards(wheel: bool) -> None:
    """The drive backwards in time: all that moves goes backwards. Without wheel angles it stays open."""
    frames = from_s(10.0, 35.0)
    end_ns = frames[0].t_ns + frames[-1].t_ns
    turned = []
    for frame in reversed(frames):
        pgn = split(frame.can_id).pgn
        if pgn in (65267, 129025) or (wheel and pgn == 65291):
            t_ns = end_ns - frame.t_ns
            turned.append(Frame(t_ns, t_ns, "can0", frame.can_id, True, False, frame.data))
    told = Followed(turned)
    here = {k.mount: k.source for k in told.state.decoder.addresses.known() if k.mount is not None}
    assert here == (right() if wheel else here) and (not here or here == right())


@pytest.mark.parametrize(("one", "other"), list(permutations(Mount, 2)), ids=str)
def test_a_twin_accuses_no_receiver(one: Mount, other: Mount) -> None:
    """A device with another receiver's NAME is taken for that one until both are heard."""
    claim, name = 0x18EEFF00 | right()[one], NAMES[other]
    assert name is not None
    told = Followed(
        [replace(f, data=name.to_bytes(8, "little")) if f.can_id == claim else f for f in from_s(0.0, 10.0)]
    )
    said = "; ".join(told.events)
    assert "two devices claim NAME" in said and "recognised by their positions" in said
    assert told.wrong == 0 and told.whole > 10
    assert not any(
        word in said for word in ("where the machine file says", "another receiver's place", "not fit")
    )
    assert "no address claim was heard" not in said  # all were
