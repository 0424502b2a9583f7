"""``python -m skyline``: the command line."""

from skyline.cli import main

main()
