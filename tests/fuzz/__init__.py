"""Mutated command lines, configurations, folders, locales, terminals and homes, for every subcommand.

``python -m tests.fuzz --count 500`` runs more of them than the tests do, ``--seed N --only K`` one of them again.
"""
