"""Names and docstrings follow the rules of docs/glossary.md."""

import name_check
import pytest


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("def turned(): ...", "no verb"),
        ("def _of(): ...", "no verb"),
        ("def by_joint(): ...", "preposition"),
        ("def told_positions(): ...", "forbidden word"),
        ("class ToldPositions: ...", "forbidden word"),
        ("def f(asked): ...", "forbidden word"),
        ("felt = 1", "forbidden word"),
        ("class A:\n    said: str", "forbidden word"),
        ('def f():\n    """What it does."""', "begins with 'What'"),
        ('class A:\n    """Those of others."""', "begins with 'Those'"),
        ('def f():\n    """Whether it is."""', "begins with 'Whether it'"),
        ('def f():\n    """Do it.\n\n    Args:\n        q: As there.\n    """', "says 'As there'"),
    ],
)
def test_words_that_say_nothing_are_found(text, says):
    assert any(says in finding for _, finding in name_check.findings(text))


@pytest.mark.parametrize(
    "text",
    [
        "def predict(): ...",
        "def from_section(): ...",
        "def offset(): ...",
        "def bypass(): ...",
        'def f():\n    """Whether item k is free."""',
        'def f():\n    """Whatever remains."""',
    ],
)
def test_good_words_pass(text):
    assert list(name_check.findings(text)) == []


def test_a_class_name_stands_in_one_module():
    assert name_check.twice([("a.py", "class A: ..."), ("b.py", "class A: ..."), ("c.py", "class B: ...")]) == [
        "class 'A' in a.py, b.py"
    ]


def test_the_code_keeps_the_rules():
    assert name_check.all_findings() == []
