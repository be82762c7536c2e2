"""The calibrated robot as source code of other languages, without this program."""
