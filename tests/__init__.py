"""Tests, which import each other as `tests.<room>.<file>`: `python -m tests.claims` runs one of them."""
