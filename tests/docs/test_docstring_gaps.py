"""The tool that lists what docstrings leave out."""

from docstring_gaps import gaps

MODULE = '''
def fine(q: FloatArray) -> FloatArray:
    """Return q (n, 3) [m].

    Raises:
        DataError: No.
    """
    raise DataError("no")

def no_shape(q: FloatArray) -> float:
    """Return something."""

def no_error() -> None:
    """Do it."""
    raise DataError("no")

def elsewhere(q: FloatArray) -> None:
    """Do it; see `fine`."""

def _private(q: FloatArray) -> None:
    pass
'''


def test_missing_shapes_and_errors_are_listed():
    assert list(gaps(MODULE)) == [(10, "no_shape", "no shape"), (13, "no_error", "raises DataError")]
