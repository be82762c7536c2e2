"""Functions of an object that are computed once for each object, and remembered.

Like `functools.cached_property`, for functions outside the class, in rooms that the class must not import.
Answers live in the object itself: they end with it, and go with it to other processes. `dataclasses.replace` makes a
new object, which knows none. The object must not change. Two threads may both compute an answer; both
get the same one.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar

Thing = TypeVar("Thing")
More = ParamSpec("More")
Answer = TypeVar("Answer")


def memoize(function: Callable[Concatenate[Thing, More], Answer]) -> Callable[Concatenate[Thing, More], Answer]:
    """Make a function of one object, and of others that belong to it, remember its answer for each object."""
    key = f"{function.__module__}.{function.__qualname__}"

    @wraps(function)
    def answer(thing: Thing, /, *more: More.args, **named: More.kwargs) -> Answer:
        known = vars(thing)
        return known[key] if key in known else known.setdefault(key, function(thing, *more, **named))

    return answer
