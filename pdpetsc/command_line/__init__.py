"""The command line: reading arguments, running a case file, comparing and drawing finished runs."""
