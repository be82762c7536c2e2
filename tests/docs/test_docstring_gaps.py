"""The tool that lists what docstrings leave out."""

from docstring_gaps import all_gaps, gaps, promises

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

def other_shapes(a: FloatArray, b: FloatArray) -> FloatArray:
    """Turn a (n + 1, 4, 4) [m] and b."""

def dots(a: FloatArray) -> FloatArray:
    """Turn a (..., n) around."""

def explained() -> None:
    """Do it, or raise `InputError`."""
    with _explain_errors(path):
        raise IsADirectoryError("no")

@click.command("do")
def command(q: FloatArray) -> None:
    """Do it from the command line."""
    raise InputError("no")
'''


BASE = '''
class Kind(ABC):
    def predict(self) -> FloatArray:
        """Return it, (n, 3)."""

class Other:
    pass

class Wider(Kind):
    @abstractmethod
    def turned(self) -> FloatArray:
        """Return it turned, (n, 3)."""
'''
CHILD = '''
class Position(Kind):
    def predict(self) -> FloatArray:
        """Return the position."""

    def more(self) -> FloatArray:
        """Return more."""
'''


def test_what_an_abstract_base_class_promises_need_not_be_said_again():
    assert promises(BASE) == {"Kind": {"predict"}, "Wider": {"predict", "turned"}}
    assert list(gaps(CHILD, promises(BASE))) == [(6, "Position.more", "no shape")]


def test_missing_shapes_and_errors_are_listed():
    assert list(gaps(MODULE, {})) == [(10, "no_shape", "no shape"), (13, "no_error", "raises DataError")]


def test_nothing_public_leaves_out_a_shape_or_an_error():
    assert list(all_gaps()) == []
