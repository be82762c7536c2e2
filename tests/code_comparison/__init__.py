"""Robot calibration codes compared on the same unseen rows of public measurements.

    python -m tests.code_comparison FOLDER [--environments FOLDER [--install]] [--page docs/comparison.md]

Each data set (`data_sets`) says where it comes from and how its rows are split. Each code (`codes`) runs in a process
and an environment of its own: it gets the nominal robot and the rows for training, and predicts poses whose readings it
never sees. Scores are computed here, alike for all.
"""
