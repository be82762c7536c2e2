"""Robot calibration codes compared on the same unseen rows of public measurements.

    python -m tests.code_comparison FOLDER [--environments FOLDER [--install]] [--page docs/comparison.md]

Each data set (`data_sets`) says where it comes from and how its rows are split. Each code (`codes`) runs in a process
and an environment of its own: it gets the nominal robot and the rows for training, and predicts poses whose readings it
never sees. Scores are computed here, alike for all.

To add a code, write a script of some 40 lines in `codes`: it reads a problem (`exchange.Problem`), solves it between
the marks around a user's lines, and answers with predicted points; name it in `codes/__init__.py`. To add a data set,
say in `data_sets` what it is (origin, licence, columns, checksum, splits), and name it in `data_sets/__init__.py`. A
kind of problem is a class there that writes a problem for codes, and says how far off predictions are.
"""
