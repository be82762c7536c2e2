"""The tool that lists what docstrings leave out: what it passes over stands in the code, of which it lists nothing."""

from docstring_gaps import all_gaps, gaps, promises

MODULE = '''
def no_shape(q: FloatArray) -> float:
    """Return something."""

def no_error() -> None:
    """Do it."""
    raise DataError("no")

class Position(Kind):
    def predict(self) -> FloatArray:
        """Return the position."""

    def more(self) -> FloatArray:
        """Return more."""
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


def test_missing_shapes_and_errors_are_listed_but_for_what_an_abstract_base_class_promises():
    assert promises(BASE) == {"Kind": {"predict"}, "Wider": {"predict", "turned"}}
    found = [(2, "no_shape", "no shape"), (5, "no_error", "raises DataError"), (13, "Position.more", "no shape")]
    assert list(gaps(MODULE, promises(BASE))) == found


def test_nothing_public_leaves_out_a_shape_or_an_error():
    assert list(all_gaps()) == []
