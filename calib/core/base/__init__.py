"""What every room stands on: arrays, units, errors, words, files, workers."""
