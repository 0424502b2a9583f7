"""What a command does between reading its options and printing: a file for each such task."""
