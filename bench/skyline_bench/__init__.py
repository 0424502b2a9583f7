"""What Skyline is measured with; Skyline itself imports none of it.

Folders import downward only: ``cli > commands > figures > runs > (cases | stores | trials) >
(queries | truth | peers) > measuring > skyline``.
"""
