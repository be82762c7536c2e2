"""The base of every room: arrays, units, errors, words, files, workers."""
