"""Examples in docstrings run, and print what they say."""

import doctest
import importlib

import api_reference
import pytest

MODULES = [name for package in api_reference.PACKAGES for name in api_reference.modules(package)]
WITH_EXAMPLES = [name for name in MODULES if ">>>" in api_reference.source(name)]


def test_there_are_examples():
    assert len(WITH_EXAMPLES) >= 4


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_the_examples_in_docstrings_print_what_they_say(name):
    outcome = doctest.testmod(importlib.import_module(name))
    assert outcome.attempted > 0
    assert outcome.failed == 0
