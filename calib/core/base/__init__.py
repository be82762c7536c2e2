"""The base of all packages: arrays, units, errors, words, files, workers."""
