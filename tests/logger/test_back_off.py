"""The wait before another try."""

from tilth.logger.back_off import BackOff


def test_the_wait_doubles_up_to_a_limit_and_begins_short_again() -> None:
    back_off = BackOff(10, 25)
    assert back_off.is_due(0)
    for t_ns, wait_ns in ((100, 10), (200, 20), (300, 25), (400, 25)):
        back_off.failed(t_ns)
        assert not back_off.is_due(t_ns + wait_ns - 1) and back_off.is_due(t_ns + wait_ns)
    back_off.worked()
    back_off.failed(500)
    assert back_off.is_due(510) and not back_off.is_due(509)
