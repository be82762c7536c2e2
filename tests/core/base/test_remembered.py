"""A function of an object is computed once for each object."""

import pickle
import threading
from dataclasses import dataclass, replace

from calib.core.base.memoize import memoize

COMPUTED = []


@dataclass(frozen=True)
class Pair:
    first: int
    second: int


@memoize
def total(pair):
    """The sum."""
    COMPUTED.append(pair)
    return [pair.first + pair.second]  # a new list each time, so that the same one shows


@memoize
def product(pair):
    return pair.first * pair.second


def test_an_answer_is_computed_once_for_each_object_and_function_and_goes_with_a_pickled_one():
    COMPUTED.clear()
    pair, other = Pair(2, 3), Pair(2, 3)
    assert (total(pair), product(pair), total(other)) == ([5], 6, [5])
    assert total(pair) is total(pair)
    assert total(replace(pair, second=5)) == [7]
    assert total(pickle.loads(pickle.dumps(pair))) == [5]
    assert len(COMPUTED) == 3


def test_equality_and_the_name_stay_what_they_were():
    pair = Pair(2, 3)
    total(pair)
    assert pair == Pair(2, 3)
    assert repr(pair) == "Pair(first=2, second=3)"
    assert (total.__name__, total.__doc__) == ("total", "The sum.")


def test_threads_that_ask_at_once_get_the_same_answer():
    both = threading.Barrier(2)

    @memoize
    def slow(pair):
        both.wait(10)  # neither goes on before both have begun
        return [pair.first]

    pair, answers = Pair(2, 3), []
    threads = [threading.Thread(target=lambda: answers.append(slow(pair))) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers[0] is answers[1]
