"""The tasks of commands, a module for each.

A task is what a command does between reading its options and printing.
"""
