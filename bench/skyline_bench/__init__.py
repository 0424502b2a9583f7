"""Benchmarks of Skyline, which itself imports none of them.

``search/`` compares stores, matchers and kinds of queries, which ``queries/`` makes. ``truth/``
compares skylines with the oracle and with closed forms; ``speed`` compares time and error with
``peers``. ``summits``, ``paper``, ``photos``, ``page`` and ``durability`` measure their subjects.
``records`` writes what was measured, and ``repeat`` measures it again. ``documents/`` and
``figures`` write the figures of the pages from the records.
"""
