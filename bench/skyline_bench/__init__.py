"""Benchmarks of Skyline, which itself imports none of them.

``search/`` compares stores, matchers and kinds of queries, which ``queries/`` makes. ``truth/``
holds skylines to the oracle and to closed forms; ``speed`` compares time and error with ``peers/``.
``summits``, ``paper``, ``photos``, ``page`` and ``durability`` measure what their names say, and
``figures`` draws the README's pictures from the records.
"""
