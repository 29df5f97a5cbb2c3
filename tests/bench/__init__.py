"""Benchmarks: ``python -m tests.bench fold|pipeline|stage|estimates|console|page``. They are no part of the product."""
