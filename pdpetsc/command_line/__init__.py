"""The command line: parse arguments, run a case file, compare and draw finished runs."""
