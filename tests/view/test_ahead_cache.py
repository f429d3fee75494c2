import threading

import pytest

from corporeal.view.ahead_cache import AheadCache

PATIENCE = 30.0


class Loads:
    """Loads when it is let, and writes down what."""

    def __init__(self):
        self.order, self.let, self.told = [], threading.Semaphore(0), threading.Semaphore(0)

    def __call__(self, number):
        assert self.let.acquire(timeout=PATIENCE)
        self.order.append(number)
        if number < 0:
            raise OSError(f"no {number}")
        return 10 * number

    def loaded(self, count):
        """Let so many be loaded, and wait for them."""
        for _ in range(count):
            self.let.release()
        for _ in range(count):
            assert self.told.acquire(timeout=PATIENCE)


@pytest.fixture
def loads():
    return Loads()


def cache_of(loads, kept):
    return AheadCache(loads, kept, lambda number: loads.told.release())


def test_get_never_waits_and_values_come_in_the_order_of_the_wishes(loads):
    cache = cache_of(loads, 5)
    cache.want([3, 1, 2])
    assert cache.get(3) is None
    loads.loaded(3)
    assert loads.order == [3, 1, 2]
    assert [cache.get(number) for number in (1, 2, 3, 4)] == [10, 20, 30, None]
    assert cache.seconds > 0
    cache.close(PATIENCE)


def test_later_wishes_replace_earlier_ones_and_nothing_is_loaded_twice(loads):
    cache = cache_of(loads, 5)
    cache.want([1, 2, 3])
    loads.loaded(1)
    cache.want([7, 1, 8])
    # 2 may have been begun before the wish came.
    loads.loaded(2)
    cache.want([7, 1, 8])
    loads.let.release()
    cache.take(8, PATIENCE)
    assert loads.order in ([1, 2, 7, 8], [1, 7, 8])
    loads.let.release()
    cache.close(PATIENCE)


def test_no_more_are_kept_than_told_and_what_is_wished_for_stays(loads):
    cache = cache_of(loads, 4)
    for start in range(0, 40, 2):
        cache.want(range(start, start + 10))
        loads.let.release()
        loads.let.release()
        assert cache.take(start, PATIENCE) == 10 * start
        assert cache.take(start + 1, PATIENCE) == 10 * (start + 1)
        assert len(cache) <= 4
    assert 0 not in cache and 38 in cache and 39 in cache
    cache.close()
    loads.let.release()


def test_take_goes_before_all_wishes(loads):
    cache = cache_of(loads, 9)
    cache.want([1, 2, 3, 4])
    loads.loaded(1)
    for _ in range(2):
        loads.let.release()
    assert cache.take(4, PATIENCE) == 40
    assert loads.order[-1] == 4 and 3 not in loads.order
    cache.close()
    loads.let.release()


def test_what_cannot_be_loaded_is_said_to_whom_takes_it_and_costs_no_other(loads):
    cache = cache_of(loads, 9)
    cache.want([-1, 5])
    loads.let.release()
    loads.loaded(1)
    assert cache.get(-1) is None and cache.get(5) == 50
    with pytest.raises(RuntimeError, match="-1") as caught:
        cache.take(-1, PATIENCE)
    assert isinstance(caught.value.__cause__, OSError)
    loads.let.release()
    with pytest.raises(RuntimeError):
        cache.take(-1, PATIENCE)
    cache.close(PATIENCE)


def test_what_is_forgotten_is_loaded_again_even_if_it_was_under_way(loads):
    cache = cache_of(loads, 9)
    cache.want([1, 2])
    loads.loaded(2)
    cache.forget(lambda value: value == 20)
    assert cache.get(1) is None and cache.get(2) == 20
    loads.loaded(1)
    assert loads.order == [1, 2, 1] and cache.get(1) == 10
    cache.close(PATIENCE)


def test_a_closed_cache_says_so(loads):
    cache = cache_of(loads, 9)
    cache.close(PATIENCE)
    with pytest.raises(TimeoutError):
        cache.take(1, PATIENCE)
    assert loads.order == []
